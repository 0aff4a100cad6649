// A job without a result: why, and another try.

import { useSignal } from '@preact/signals';

import { retry, type Job } from '../api/client.ts';
import { own, problemOf, type Problem } from '../api/problem.ts';
import { go } from '../state/route.ts';
import { Notice } from './Notice.tsx';

export function Failed({ job }: { job: Job }) {
  const problem = useSignal<Problem | null>(null);
  const again = async () => {
    try {
      go(`#/jobs/${(await retry(job.id)).id}`);
    } catch (error) {
      problem.value = problemOf(error);
    }
  };
  return (
    <>
      {job.state === 'cancelled' ? (
        <p>It was cancelled; nothing was kept but its input.</p>
      ) : (
        <Notice problem={job.problem ? { ...own('', '', ''), ...job.problem } : own('job.failed', 'The job failed', 'It said no more.')} />
      )}
      {problem.value && <Notice problem={problem.value} />}
      <div class="row">
        <button class="main" type="button" onClick={() => void again()}>Run it again on the same input</button>
        <a class="button" href="#/">Another cloud</a>
      </div>
    </>
  );
}
