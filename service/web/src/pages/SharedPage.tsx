// A job that somebody has shared: to look at and take home.

import { useSignal } from '@preact/signals';
import { useEffect } from 'preact/hooks';

import { ENDED, shared, type Job } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { Notice } from '../parts/Notice.tsx';
import { Result } from '../parts/Result.tsx';
import { Stage } from '../parts/Stage.tsx';
import { drop } from '../state/cloud.ts';
import { clear } from '../state/view.ts';
import { showMesh } from './JobPage.tsx';

const PAUSE_SECONDS = 3;

export function SharedPage({ token }: { token: string }) {
  const job = useSignal<Job | null>(null);
  const problem = useSignal<Problem | null>(null);
  const base = `/shared/${token}`;
  useEffect(() => {
    let timer = 0;
    let gone = false;
    clear();
    drop();
    const look = async () => {
      try {
        job.value = await shared(token);
        if (job.value.state === 'succeeded') await showMesh(job.value, base);
      } catch (error) {
        problem.value = problemOf(error);
      }
      if (!gone && !problem.value && !ENDED.has(job.value?.state ?? '')) {
        timer = window.setTimeout(() => void look(), PAUSE_SECONDS * 1000);
      }
    };
    void look();
    return () => {
      gone = true;
      clearTimeout(timer);
    };
  }, [token]);
  const now = job.value;
  return (
    <main class="work">
      <Stage />
      <div class="panel">
        {problem.value && <Notice problem={problem.value} />}
        {now && (
          <>
            <h1>{now.label || now.input?.name || 'A surface'} <span class={`state ${now.state}`}>{now.state}</span></h1>
            <p class="limits">Shared with you to look at.</p>
            {now.state === 'succeeded' && <Result job={now} base={base} own={false} />}
            {now.progress && !ENDED.has(now.state) && <progress max={1} value={now.progress.fraction} aria-label="Of the whole job" />}
          </>
        )}
      </div>
    </main>
  );
}
