// What a job has left: the surface, what it is like, and ways to take it home.

import { useSignal } from '@preact/signals';
import { useEffect } from 'preact/hooks';

import { file, type Job } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { moment } from '../state/format.ts';
import { headline, sentences, type Report } from '../state/report.ts';
import { unit, UNITS } from '../state/unit.ts';
import { Again } from './Again.tsx';
import { CutPanel } from './CutPanel.tsx';
import { Downloads } from './Downloads.tsx';
import { LayerChoice } from './LayerChoice.tsx';
import { Notice } from './Notice.tsx';
import { ShareBox } from './ShareBox.tsx';

interface Props {
  job: Job;
  /** Where its files are: /jobs/… or /shared/…. */
  base: string;
  /** Whether its owner looks at it, who may do more. */
  own: boolean;
}

export function Result({ job, base, own }: Props) {
  const report = useSignal<Report | null>(null);
  const problem = useSignal<Problem | null>(null);
  useEffect(() => {
    file(`${base}/report.json`)
      .then((response) => response.json())
      .then((found: Report) => (report.value = found))
      .catch((error: unknown) => (problem.value = problemOf(error)));
  }, [base]);
  const found = report.value;
  return (
    <>
      {problem.value && <Notice problem={problem.value} />}
      {found && <Words report={found} />}
      {job.artifacts['mesh.glb'] && <LayerChoice />}
      {found && <CutPanel job={job} base={base} slices={found.slices ?? []} own={own} />}
      <Downloads job={job} base={base} />
      {own && <Again job={job} />}
      {own && <ShareBox job={job} />}
      <p class="limits">
        Finished {job.finished_at ? moment(job.finished_at) : ''}; kept until {moment(job.expires_at)}.
      </p>
    </>
  );
}

function Words({ report }: { report: Report }) {
  return (
    <section aria-label="Report" class="words">
      <p class="headline">{headline(report)}</p>
      {report.surface && !unit.value && (
        <label class="unit">
          Unit of the coordinates{' '}
          <select value={unit.value} onChange={(event) => (unit.value = event.currentTarget.value)}>
            {Object.keys(UNITS).map((name) => <option key={name} value={name}>{name || 'not told'}</option>)}
          </select>
        </label>
      )}
      <details>
        <summary>In words</summary>
        {sentences(report).map((said) => <p key={said}>{said}</p>)}
        {(report.input?.notes ?? []).length > 0 && (
          <ul>{report.input?.notes.map((note) => <li key={note}>{note}</li>)}</ul>
        )}
      </details>
    </section>
  );
}
