// The surface again from the same field, at another resolution: seconds, without refitting.

import { useSignal } from '@preact/signals';

import { extract, retry, type Job } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { go } from '../state/route.ts';
import { Notice } from './Notice.tsx';

export function Again({ job }: { job: Job }) {
  const problem = useSignal<Problem | null>(null);
  const busy = useSignal(false);
  const begin = async (make: () => Promise<Job>) => {
    busy.value = true;
    try {
      go(`#/jobs/${(await make()).id}`);
    } catch (error) {
      problem.value = problemOf(error);
    } finally {
      busy.value = false;
    }
  };
  const submit = (event: SubmitEvent) => {
    event.preventDefault();
    const data = new FormData(event.currentTarget as HTMLFormElement);
    void begin(() => extract(job.id, { resolution: Number(data.get('resolution')) }));
  };
  return (
    <section class="again" aria-label="Again">
      <h2>Again</h2>
      <form class="row" onSubmit={submit}>
        <label>
          Cells along the longest side{' '}
          <input name="resolution" type="number" min={16} max={2048} step={1} required defaultValue="256" />
        </label>
        <button type="submit" disabled={busy.value}>Take the surface again</button>
      </form>
      <p class="limits">From the fitted field, in seconds. Its vertices are the network’s own, not moved onto the data.</p>
      {job.parent && job.kind === 'extraction' && <p><a href={`#/jobs/${job.parent}`}>The job it came from</a></p>}
      {job.kind === 'fit' && (
        <button type="button" disabled={busy.value} onClick={() => void begin(() => retry(job.id))}>
          Fit it again with the same options
        </button>
      )}
      {problem.value && <Notice problem={problem.value} />}
    </section>
  );
}
