// A link with which anybody may look at this job, until it lapses.

import { useSignal } from '@preact/signals';

import { share, unshare, type Job } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { moment } from '../state/format.ts';
import { Notice } from './Notice.tsx';

const DAY = 86_400;
const TIMES: [number, string][] = [[DAY, 'a day'], [7 * DAY, 'a week'], [90 * DAY, '90 days']];

interface Made {
  id: string;
  url: string;
  until: string;
}

export function ShareBox({ job }: { job: Job }) {
  const made = useSignal<Made | null>(null);
  const copied = useSignal(false);
  const problem = useSignal<Problem | null>(null);
  const attempt = async (act: () => Promise<void>) => {
    try {
      problem.value = null;
      await act();
    } catch (error) {
      problem.value = problemOf(error);
    }
  };
  const submit = (event: SubmitEvent) => {
    event.preventDefault();
    const seconds = Number(new FormData(event.currentTarget as HTMLFormElement).get('seconds'));
    void attempt(async () => {
      const { id, href, expires_at } = await share(job.id, seconds);
      // The token stands behind the #, so that it is in no log of the page's server.
      const url = `${location.origin}${location.pathname}#${href}`;
      made.value = { id, url, until: moment(expires_at) };
      copied.value = false;
    });
  };
  const now = made.value;
  return (
    <section class="share" aria-label="Share">
      <h2>Share</h2>
      {!now && (
        <form class="row" onSubmit={submit}>
          <label>
            For{' '}
            <select name="seconds" defaultValue={String(7 * DAY)}>
              {TIMES.map(([value, title]) => <option key={value} value={value} selected={value === 7 * DAY}>{title}</option>)}
            </select>
          </label>
          <button type="submit">Make a link</button>
        </form>
      )}
      {now && (
        <>
          <label>
            Anybody with this link may read this job and its files until {now.until}. It is shown only once.
            <input class="wide" readOnly value={now.url} onFocus={(event) => event.currentTarget.select()} />
          </label>
          <div class="row">
            <button
              type="button"
              onClick={() => void navigator.clipboard.writeText(now.url).then(() => (copied.value = true), () => {})}
            >
              {copied.value ? 'Copied' : 'Copy'}
            </button>
            <button type="button" onClick={() => void attempt(async () => {
              await unshare(job.id, now.id);
              made.value = null;
            })}>
              End it
            </button>
          </div>
        </>
      )}
      {problem.value && <Notice problem={problem.value} />}
    </section>
  );
}
