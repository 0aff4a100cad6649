// One job: while it waits and runs, and what it left.

import { effect } from '@preact/signals';
import { useEffect, useMemo } from 'preact/hooks';

import { ENDED, file, type Job } from '../api/client.ts';
import { Notice } from '../parts/Notice.tsx';
import { Failed } from '../parts/Failed.tsx';
import { Result } from '../parts/Result.tsx';
import { Running } from '../parts/Running.tsx';
import { Stage } from '../parts/Stage.tsx';
import { showInput, shown } from '../state/cloud.ts';
import { Follower } from '../state/follow.ts';
import { askService } from '../state/service.ts';
import * as view from '../state/view.ts';

export function JobPage({ id }: { id: string }) {
  const follower = useMemo(() => new Follower(id), [id]);
  useEffect(() => {
    view.clear();
    follower.start();
    const ends = [
      effect(() => {
        const preview = follower.preview.value;
        if (preview && !ENDED.has(follower.job.value?.state ?? '')) view.glb.value = preview.glb;
      }),
      whenFirst(follower, (job) => void showInput(job)),
      whenEnded(follower, (job) => {
        void askService(); // its rate may be known better now
        return showMesh(job, `/jobs/${id}`);
      }),
    ];
    return () => {
      ends.forEach((end) => end());
      follower.stop();
    };
  }, [id]);

  const job = follower.job.value;
  const note = shown.value?.note;
  return (
    <main class="work">
      <Stage>
        {job?.state === 'running' && !view.glb.value && (
          <p class="over low">The first preview comes some seconds into the fit.</p>
        )}
      </Stage>
      <div class="panel">
        {follower.problem.value && <Notice problem={follower.problem.value} />}
        {!job && !follower.problem.value && <p>Looking for the job …</p>}
        {job && (
          <>
            <h1>
              {job.label || job.input?.name || 'Job'} <span class={`state ${job.state}`}>{job.state}</span>
            </h1>
            {(job.state === 'queued' || job.state === 'running') && <Running follower={follower} job={job} />}
            {job.state === 'succeeded' && <Result job={job} base={`/jobs/${id}`} own />}
            {(job.state === 'failed' || job.state === 'cancelled') && <Failed job={job} />}
            {note && <p class="note">{note}</p>}
          </>
        )}
      </div>
    </main>
  );
}

export async function showMesh(job: Job, base: string): Promise<void> {
  const mesh = job.artifacts['mesh.glb'];
  if (mesh) view.glb.value = await (await file(`${base}/mesh.glb`)).arrayBuffer();
  else view.glb.value = null;
}

function whenFirst(follower: Follower, act: (job: Job) => void): () => void {
  let done = false;
  return effect(() => {
    const job = follower.job.value;
    if (done || !job) return;
    done = true;
    setTimeout(() => act(job));
  });
}

function whenEnded(follower: Follower, act: (job: Job) => Promise<void>): () => void {
  let done = false;
  return effect(() => {
    const job = follower.job.value;
    if (done || job?.state !== 'succeeded') return;
    done = true;
    setTimeout(() => void act(job).catch(() => {}));
  });
}
