// A cloud as the page shows it.

import type { Reading } from './reading.ts';

/** More points than this tell the eye nothing, and cost every frame. */
export const SHOWN_MOST = 500_000;

export type Triple = [number, number, number];

export interface Cloud {
  /** Points of the file that have finite coordinates. */
  count: number;
  /** Not finite, left out. */
  dropped: number;
  /** How many of them are drawn. */
  shown: number;
  low: Triple;
  high: Triple;
  /** Middle of the box: what the coordinates below are relative to, in double precision. */
  origin: Triple;
  /** (shown, 3) relative to `origin`. */
  positions: Float32Array;
  /** (shown, 3), or null. */
  colors: Uint8Array | null;
  dialect: string;
}

/** All points relative to the middle of their box: single precision is enough there. */
export interface Centred {
  points: Float32Array;
  colors: Uint8Array | null;
  origin: Triple;
  low: Triple;
  high: Triple;
  dropped: number;
}

export function centred({ points, colors }: Reading): Centred {
  const low: Triple = [Infinity, Infinity, Infinity];
  const high: Triple = [-Infinity, -Infinity, -Infinity];
  let kept = 0;
  for (let at = 0; at < points.length; at += 3) {
    const x = points[at] as number;
    const y = points[at + 1] as number;
    const z = points[at + 2] as number;
    if (!(Math.abs(x) < 1e100 && Math.abs(y) < 1e100 && Math.abs(z) < 1e100)) continue;
    if (kept !== at) {
      points.copyWithin(kept, at, at + 3);
      colors?.copyWithin(kept, at, at + 3);
    }
    kept += 3;
    if (x < low[0]) low[0] = x;
    if (y < low[1]) low[1] = y;
    if (z < low[2]) low[2] = z;
    if (x > high[0]) high[0] = x;
    if (y > high[1]) high[1] = y;
    if (z > high[2]) high[2] = z;
  }
  const origin = low.map((value, k) => (value + (high[k] as number)) / 2) as Triple;
  const local = new Float32Array(kept);
  for (let at = 0; at < kept; at++) local[at] = (points[at] as number) - (origin[at % 3] as number);
  return {
    points: local, colors: colors && colors.subarray(0, kept), origin, low, high,
    dropped: (points.length - kept) / 3,
  };
}

/** Every so many-th point: files are often in scan lines, so the place within each run varies. */
export function thinned(all: Centred, dialect: string, most = SHOWN_MOST): Cloud {
  const count = all.points.length / 3;
  const shown = Math.min(count, most);
  const { low, high, origin, dropped } = all;
  const about = { count, dropped, shown, low, high, origin, dialect };
  if (shown === count) return { ...about, positions: all.points.slice(), colors: all.colors?.slice() ?? null };
  const positions = new Float32Array(3 * shown);
  const colors = all.colors ? new Uint8Array(3 * shown) : null;
  let state = 1;
  for (let i = 0; i < shown; i++) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const from = 3 * Math.min(count - 1, Math.floor(((i + state / 2 ** 32) * count) / shown));
    for (let k = 0; k < 3; k++) {
      positions[3 * i + k] = all.points[from + k] as number;
      if (colors) colors[3 * i + k] = (all.colors as Uint8Array)[from + k] as number;
    }
  }
  return { ...about, positions, colors };
}
