// The cloud that is shown, wherever it came from: dropped here, or the input of a job.

import { signal } from '@preact/signals';

import { file, show, type Job } from '../api/client.ts';
import { Refusal } from '../api/problem.ts';
import type { Cloud } from '../cloud/cloud.ts';
import { Unreadable } from '../cloud/reading.ts';
import { readFile, SHOWN_BYTES } from '../cloud/thread.ts';

export interface Shown {
  /** The file, where it was chosen here. */
  file: File | null;
  /** The fits whose input it is. */
  job: string | null;
  cloud: Cloud | null;
  /** Why there is nothing to see, in words. */
  note: string;
}

export const shown = signal<Shown | null>(null);
export const reading = signal(false);

export function drop(): void {
  shown.value = null;
}

/** Show a file that was chosen. */
export async function choose(chosen: File): Promise<void> {
  await put({ file: chosen, job: null }, () => readFile(chosen));
}

/** Note that the file chosen here has become the input of a job. */
export function belongsTo(job: string): void {
  if (shown.value) shown.value = { ...shown.value, job };
}

/** Show the input of a job, unless it is shown already. */
export async function showInput(job: Job): Promise<void> {
  let fit = job;
  try {
    while (fit.kind === 'extraction' && fit.parent) fit = await show(fit.parent);
  } catch (error) {
    if (!(error instanceof Refusal)) throw error;
  }
  if (shown.value?.job === fit.id) return;
  const href = fit.links['input'];
  if (fit.kind === 'extraction' || !href) {
    shown.value = { file: null, job: fit.id, cloud: null, note: 'The input points are not kept with this result.' };
    return;
  }
  await put({ file: null, job: fit.id }, async () => {
    if ((fit.input?.bytes ?? 0) > SHOWN_BYTES) throw new Unreadable('The input is too large to be shown here.');
    return readFile(await (await file(href)).blob());
  });
}

async function put(what: Pick<Shown, 'file' | 'job'>, read: () => Promise<Cloud>): Promise<void> {
  const mine: Shown = { ...what, cloud: null, note: '' };
  shown.value = mine;
  reading.value = true;
  let found: Pick<Shown, 'cloud' | 'note'>;
  try {
    found = { cloud: await read(), note: '' };
  } catch (error) {
    found = { cloud: null, note: error instanceof Error ? error.message : String(error) };
  }
  // Another cloud may have been chosen meanwhile, and this one may have become a job's input.
  if (shown.value && shown.value.file === mine.file && (shown.value === mine || mine.file)) {
    shown.value = { ...shown.value, ...found };
  }
  reading.value = false;
}
