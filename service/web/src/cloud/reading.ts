// What the readers give: plain arrays, before anything is moved or thinned.

export interface Reading {
  /** (n, 3) in the file's own coordinates. */
  points: Float64Array;
  /** (n, 3) of 0..255, or null. */
  colors: Uint8Array | null;
  /** How the file is written, in words. */
  dialect: string;
}

/** A file that cannot be shown; the service, which reads more, may still take it. */
export class Unreadable extends Error {}

/** 8-bit colours of values (n, 3), after mpf_core/cloud/attributes.py; null on no known scale. */
export function toBytes(values: Float32Array, whole: boolean): Uint8Array | null {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (Number.isNaN(value)) return null;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (values.length === 0 || low < 0 || high > 65535) return null;
  let factor = 1;
  if (whole) factor = high <= 255 ? 1 : 255 / 65535;
  else if (high <= 1) factor = 255;
  else if (high > 255) return null;
  const bytes = new Uint8Array(values.length);
  for (let i = 0; i < values.length; i++) bytes[i] = Math.round((values[i] as number) * factor);
  return bytes;
}
