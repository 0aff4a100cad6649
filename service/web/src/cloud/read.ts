// Which reader: by content, as the service decides.

import { readPly } from './ply.ts';
import { Unreadable, type Reading } from './reading.ts';
import { readText } from './text.ts';

export function readCloud(bytes: Uint8Array): Reading {
  if (bytes.length === 0) throw new Unreadable('The file is empty.');
  const start = new TextDecoder('latin1').decode(bytes.subarray(0, 5));
  return /^ply[\r\n]/.test(start) ? readPly(bytes) : readText(bytes);
}
