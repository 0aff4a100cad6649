// Slices of fields that the job has not drawn: taken from its field by an extraction, once.

import { ENDED, extract, file, list, show, type Job } from '../api/client.ts';
import { own, Refusal } from '../api/problem.ts';
import { AXES, type Slice } from '../view/axes.ts';
import type { Report } from './report.ts';

export interface Stack {
  slices: Slice[];
  /** Where their files are. */
  base: string;
}

const COUNT = 24; // along each axis
const WAIT_SECONDS = 30;

/** The slices of r, θ or P; rejects with Refusal. */
export async function stackOf(job: Job, field: string): Promise<Stack> {
  const label = `slices of ${field} for ${job.id}`;
  let made = (await list({ label, limit: 5 })).jobs.find(({ state }) => state !== 'failed' && state !== 'cancelled');
  if (!made) {
    const cuts = AXES.map((axis) => ({ field, axis, count: COUNT }));
    made = await extract(job.id, { mesh: false, cuts }, label);
  }
  while (!ENDED.has(made.state)) made = await show(made.id, WAIT_SECONDS);
  if (made.state !== 'succeeded') {
    throw new Refusal({ ...own('slices.failed', 'The slices were not made', 'Their job ended without a result.'), ...made.problem });
  }
  const base = `/jobs/${made.id}`;
  const report = (await (await file(`${base}/report.json`)).json()) as Report;
  return { slices: report.slices ?? [], base };
}
