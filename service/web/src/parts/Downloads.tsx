// The files of the result, with their sizes.

import { useSignal } from '@preact/signals';

import type { Job } from '../api/client.ts';
import { download } from '../api/pictures.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { bytes } from '../state/format.ts';
import { Notice } from './Notice.tsx';

const FILES: [string, string][] = [
  ['mesh.glb', 'Surface for viewers (GLB)'],
  ['mesh.ply', 'Surface in the input’s coordinates (PLY)'],
  ['report.json', 'Report (JSON)'],
  ['field.safetensors', 'Fitted field'],
];

export function Downloads({ job, base }: { job: Job; base: string }) {
  const problem = useSignal<Problem | null>(null);
  const all = Object.entries(job.artifacts);
  const slices = all.filter(([name]) => name.startsWith('slices/'));
  const total = all.reduce((sum, [, about]) => sum + about.bytes, 0);
  const stem = (job.input?.name ?? 'surface').replace(/\.[^.]*$/, '');
  const save = (name: string) => {
    problem.value = null;
    download(`${base}/${name}`, name === 'result.zip' ? `${stem}.zip` : `${stem}-${name}`).catch(
      (error: unknown) => (problem.value = problemOf(error)),
    );
  };
  const line = (name: string, title: string, size: number) => (
    <li key={name}>
      <button type="button" onClick={() => save(name)}>{title}</button> <small>{bytes(size)}</small>
    </li>
  );
  return (
    <section class="downloads" aria-label="Downloads">
      <h2>Take it home</h2>
      <ul>
        {FILES.flatMap(([name, title]) => {
          const about = job.artifacts[name];
          return about ? [line(name, title, about.bytes)] : [];
        })}
        {base.startsWith('/jobs/') && line(
          'result.zip', slices.length ? `All of it, with ${slices.length} slices (ZIP)` : 'All of it (ZIP)', total,
        )}
      </ul>
      {problem.value && <Notice problem={problem.value} />}
    </section>
  );
}
