// A job that waits or runs: where it is, how its losses fall, and the ways to end it.

import { useSignal } from '@preact/signals';

import { cancel, type Job } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import type { Follower, Link } from '../state/follow.ts';
import { count, seconds } from '../state/format.ts';
import { Losses } from './Losses.tsx';
import { Notice } from './Notice.tsx';

const STAGES: Record<string, string> = {
  read: 'Reading the points', prepare: 'Measuring the points', initialize: 'Finding a first surface',
  fit: 'Fitting the field', extract: 'Taking the surface from the field', slices: 'Drawing slices',
  report: 'Measuring the surface', done: 'Writing the result',
};
/** When there is no fit left to stop. */
const AFTER_FIT = new Set(['extract', 'report', 'done']);
const LINKS: Record<Link, string> = {
  connecting: 'Connecting …', live: '', polling: 'Following by polls: events do not come through here.',
  lost: 'The service does not answer; trying again. The job goes on without this page.', done: '',
};

export function Running({ follower, job }: { follower: Follower; job: Job }) {
  const problem = useSignal<Problem | null>(null);
  const stop = async (keep: boolean) => {
    try {
      await cancel(job.id, keep);
      await follower.refresh();
      problem.value = null;
    } catch (error) {
      problem.value = problemOf(error);
    }
  };
  const link = LINKS[follower.link.value];
  const fits = job.kind === 'fit' && job.state === 'running' && !AFTER_FIT.has(job.progress?.stage ?? '');
  return (
    <section class="running" aria-label="Progress">
      {job.state === 'queued' ? <Waiting job={job} /> : <Stage job={job} />}
      <p class="link" role="status">{link}</p>
      <div class="row">
        {fits && (
          <button class="main" type="button" disabled={job.cancelling} onClick={() => void stop(true)}>
            Good enough: stop here and keep it
          </button>
        )}
        <button type="button" disabled={job.cancelling} onClick={() => void stop(false)}>Cancel</button>
      </div>
      {job.cancelling && <p class="note">It was asked to stop.</p>}
      {problem.value && <Notice problem={problem.value} />}
      <Losses points={follower.history.value} />
    </section>
  );
}

function Waiting({ job }: { job: Job }) {
  const before = job.queue_position;
  return (
    <p role="status">
      {before == null ? 'Waiting for a worker.' : before === 0 ? 'Next in the queue.' : `${count(before)} before it in the queue.`}
      {job.attempt > 1 && ` Attempt ${job.attempt}: it goes on from where the last one was.`}
    </p>
  );
}

function Stage({ job }: { job: Job }) {
  const { progress } = job;
  const stage = progress ? (STAGES[progress.stage] ?? progress.stage) : 'Starting';
  return (
    <>
      <p class="stage-name" role="status">{stage}</p>
      <progress max={1} value={progress?.fraction ?? 0} aria-label="Of the whole job" />
      <dl>
        {job.tiles && progress?.stage === 'fit' && (
          <>
            <dt>Tiles</dt>
            <dd>{count(job.tiles.done)} of {count(job.tiles.total)} fitted, {count(job.tiles.running)} under way</dd>
          </>
        )}
        {progress?.iteration != null && (
          <>
            <dt>Iteration</dt>
            <dd>{count(progress.iteration)} of at most {count(progress.iterations ?? 0)}</dd>
          </>
        )}
        {progress && <><dt>Running for</dt><dd>{seconds(progress.seconds)}</dd></>}
        {progress?.eta != null && <><dt>Left</dt><dd>about {seconds(progress.eta)}{!job.tiles && ', then the surface is taken'}</dd></>}
        {job.attempt > 1 && <><dt>Attempt</dt><dd>{job.attempt}</dd></>}
      </dl>
    </>
  );
}
