// The losses of a fit as they were told. The service keeps the last thousand events; a page that is
// loaded anew goes on where it was, so what it knew is kept for this tab.

import type { Progress } from '../api/client.ts';

export interface Point {
  iteration: number;
  attempt: number;
  terms: Record<string, number>;
}

export interface History {
  points: Point[];
  /** The id of the last event that was seen. */
  last: string;
}

const MOST = 600;
const name = (id: string) => `mpf.history.${id}`;

export function recall(id: string): History {
  try {
    const found = JSON.parse(sessionStorage.getItem(name(id)) ?? '') as History;
    if (Array.isArray(found.points) && typeof found.last === 'string') return found;
  } catch {
    // None, or of another version.
  }
  return { points: [], last: '' };
}

export function keep(id: string, history: History): void {
  try {
    sessionStorage.setItem(name(id), JSON.stringify(history));
  } catch {
    forget(id); // the tab's store is full; the curves then begin anew after a reload
  }
}

export function forget(id: string): void {
  sessionStorage.removeItem(name(id));
}

/** The points with one more; where there are too many, every other one goes. */
export function extended(points: Point[], progress: Progress, attempt: number): Point[] {
  if (progress.iteration == null || progress.loss == null) return points;
  const terms = { total: progress.loss, ...progress.losses };
  const last = points.at(-1);
  // A new attempt goes on from a checkpoint: what the lost one did after it did not happen.
  const kept =
    last && progress.iteration <= last.iteration
      ? points.filter((p) => p.iteration < (progress.iteration as number))
      : points;
  const more = [...kept, { iteration: progress.iteration, attempt, terms }];
  return more.length > MOST ? more.filter((_, k) => k % 2 === 0 || k === more.length - 1) : more;
}
