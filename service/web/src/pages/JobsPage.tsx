// All of the caller's jobs, newest first.

import { useSignal } from '@preact/signals';
import { useEffect } from 'preact/hooks';

import { ENDED, list, remove, retry, type Job } from '../api/client.ts';
import { key } from '../api/access.ts';
import { pictureUrl } from '../api/pictures.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { Notice } from '../parts/Notice.tsx';
import { count, moment } from '../state/format.ts';
import { go } from '../state/route.ts';

const PAUSE_SECONDS = 4;

export function JobsPage() {
  const jobs = useSignal<Job[] | null>(null);
  const next = useSignal<string | null>(null);
  const problem = useSignal<Problem | null>(null);
  const look = async () => {
    try {
      const page = await list({ limit: Math.min(200, Math.max(50, jobs.value?.length ?? 0)) });
      jobs.value = page.jobs;
      next.value = page.next ?? null;
      problem.value = null;
    } catch (error) {
      problem.value = problemOf(error);
    }
  };
  const more = async () => {
    const page = await list({ cursor: next.value ?? '' });
    jobs.value = [...(jobs.value ?? []), ...page.jobs];
    next.value = page.next ?? null;
  };
  useEffect(() => {
    void look();
    const timer = setInterval(() => {
      if (document.visibilityState === 'visible' && (problem.value || jobs.value?.some(({ state }) => !ENDED.has(state)))) void look();
    }, PAUSE_SECONDS * 1000);
    return () => clearInterval(timer);
  }, [key.value]);
  const act = async (what: () => Promise<unknown>) => {
    try {
      await what();
      await look();
    } catch (error) {
      problem.value = problemOf(error);
    }
  };
  return (
    <main class="list">
      <h1>Jobs</h1>
      {problem.value && <Notice problem={problem.value} />}
      {jobs.value?.length === 0 && <p>None yet. <a href="#/">Begin with a point cloud.</a></p>}
      <ul class="jobs">
        {jobs.value?.map((job) => (
          <Row
            key={job.id} job={job} pictured={picturedBy(job, jobs.value ?? [])}
            onDelete={() => act(() => remove(job.id))}
            onRetry={() => act(async () => go(`#/jobs/${(await retry(job.id)).id}`))}
          />
        ))}
      </ul>
      {next.value && <button type="button" onClick={() => void act(more)}>Earlier ones</button>}
    </main>
  );
}

interface RowProps {
  job: Job;
  /** Whose slices are its thumbnail. */
  pictured: Job;
  onDelete: () => Promise<void>;
  onRetry: () => Promise<void>;
}

function Row({ job, pictured, onDelete, onRetry }: RowProps) {
  const sure = useSignal(false);
  const title = titleOf(job);
  return (
    <li>
      <Thumbnail job={pictured} />
      <div class="about">
        <a href={`#/jobs/${job.id}`}>{title}</a> <span class={`state ${job.state}`}>{job.state}</span>
        <p>
          {moment(job.created_at)}
          {job.input?.points != null && `, ${count(job.input.points)} points`}
          {job.kind === 'fit' && `, ${String(job.options['preset'] ?? '')}`}
          {job.state === 'running' && job.progress && `, ${Math.round(100 * job.progress.fraction)} %`}
          {job.state === 'queued' && job.queue_position != null && `, ${count(job.queue_position)} before it`}
        </p>
        {job.problem && job.state === 'failed' && <p class="note">{job.problem.title}. {job.problem.advice}</p>}
      </div>
      <div class="row">
        {ENDED.has(job.state) && (
          <button type="button" aria-label={`Retry ${title}`} onClick={() => void onRetry()}>Retry</button>
        )}
        <button
          type="button" class={sure.value ? 'danger' : ''} aria-label={sure.value ? `Really delete ${title}` : `Delete ${title}`}
          onBlur={() => (sure.value = false)}
          onClick={() => (sure.value ? void onDelete() : (sure.value = true))}
        >
          {sure.value ? 'Really delete' : 'Delete'}
        </button>
      </div>
    </li>
  );
}

function titleOf(job: Job): string {
  if (job.label) return job.label.replace(/ for [0-9a-f]{32}$/, '');
  return job.kind === 'extraction' ? 'Surface again' : (job.input?.name ?? job.id);
}

/** The job itself, or the one it came from where it has drawn nothing. */
function picturedBy(job: Job, jobs: Job[]): Job {
  const drawn = Object.keys(job.artifacts).some((name) => name.startsWith('slices/'));
  const parent = jobs.find(({ id }) => id === job.parent);
  return drawn || !parent ? job : picturedBy(parent, jobs);
}

/** The middle slice across y: in it a shape is best told. */
function Thumbnail({ job }: { job: Job }) {
  const url = useSignal('');
  const names = Object.keys(job.artifacts).filter((name) => /^slices\/(\w+\/)?y\//.test(name));
  const name = names.sort((a, b) => indexOf(a) - indexOf(b))[Math.floor(names.length / 2)];
  useEffect(() => {
    if (name) pictureUrl(`/jobs/${job.id}/${name}`).then((found) => (url.value = found)).catch(() => {});
  }, [name]);
  return <span class="thumbnail">{url.value && <img src={url.value} alt="" loading="lazy" />}</span>;
}

function indexOf(name: string): number {
  return Number(/(\d+)\.png$/.exec(name)?.[1] ?? 0);
}
