// PLY point clouds, and meshes read as clouds: text and both binary byte orders.

import { hasAll, type Role } from './columns.ts';
import { numberIn } from './numbers.ts';
import { readHeader, SIZES, type Element, type Kind, type PlyHeader } from './plyheader.ts';
import { toBytes, Unreadable, type Reading } from './reading.ts';

const COORDINATES: Role[] = ['x', 'y', 'z'];
const COLORS: Role[] = ['red', 'green', 'blue'];

/** What each property goes to: an array, and the place in its row. */
interface Target {
  values: Float64Array | Float32Array;
  place: number;
}

export function readPly(bytes: Uint8Array): Reading {
  const header = readHeader(bytes);
  const { vertex, roles } = header;
  const smallest = vertex.properties.reduce((n, p) => n + SIZES[p.length ?? p.kind], 0);
  if (vertex.count * (header.encoding === 'ascii' ? 1 : smallest) > bytes.length) {
    throw new Unreadable(`The header declares ${vertex.count} points, more than the file holds.`);
  }
  const points = new Float64Array(3 * vertex.count);
  const colored = hasAll(roles, COLORS);
  const colors = colored ? new Float32Array(3 * vertex.count) : null;
  const targets: (Target | undefined)[] = vertex.properties.map(() => undefined);
  COORDINATES.forEach((role, place) => (targets[roles[role] as number] = { values: points, place }));
  if (colors) {
    COLORS.forEach((role, place) => (targets[roles[role] as number] = { values: colors, place }));
  }
  if (header.encoding === 'ascii') readText(bytes, header, targets);
  else readBinary(bytes, header, targets);
  const whole = COLORS.every((role) => /[iu]/.test(vertex.properties[roles[role] ?? -1]?.kind ?? ''));
  return {
    points,
    colors: colors && toBytes(colors, whole),
    dialect: `PLY, ${header.encoding.replaceAll('_', ' ')}`,
  };
}

function readBinary(bytes: Uint8Array, header: PlyHeader, targets: (Target | undefined)[]): void {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const little = header.encoding === 'binary_little_endian';
  let at = header.offset;
  try {
    for (const element of header.elements) {
      if (element === header.vertex) {
        if (element.properties.some((p) => p.length)) walk(view, element, at, little, targets);
        else readFixed(view, element, at, little, targets);
        return;
      }
      at = walk(view, element, at, little, []);
    }
  } catch (error) {
    if (error instanceof RangeError) throw new Unreadable('The file ends before its points do.');
    throw error;
  }
}

/** Rows of one length: column by column. */
function readFixed(
  view: DataView, element: Element, start: number, little: boolean, targets: (Target | undefined)[],
): void {
  const stride = element.properties.reduce((n, p) => n + SIZES[p.kind], 0);
  if (start + stride * element.count > view.byteLength) {
    throw new Unreadable('The file ends before its points do.');
  }
  let column = 0;
  element.properties.forEach((property, index) => {
    const target = targets[index];
    if (target) {
      const { values, place } = target;
      const read = READERS[property.kind];
      for (let row = 0, at = start + column; row < element.count; row++, at += stride) {
        values[3 * row + place] = read(view, at, little);
      }
    }
    column += SIZES[property.kind];
  });
}

/** Rows with lists, one value after another; where they end. */
function walk(
  view: DataView, element: Element, start: number, little: boolean, targets: (Target | undefined)[],
): number {
  const { properties, count } = element;
  if (!properties.some((p) => p.length) && targets.length === 0) {
    return start + count * properties.reduce((n, p) => n + SIZES[p.kind], 0);
  }
  let at = start;
  for (let row = 0; row < count; row++) {
    for (let index = 0; index < properties.length; index++) {
      const { kind, length } = properties[index] as Element['properties'][number];
      if (length) {
        at += SIZES[length] + READERS[length](view, at, little) * SIZES[kind];
        continue;
      }
      const target = targets[index];
      if (target) target.values[3 * row + target.place] = READERS[kind](view, at, little);
      at += SIZES[kind];
    }
  }
  return at;
}

type Read = (view: DataView, at: number, little: boolean) => number;

const READERS: Record<Kind, Read> = {
  i1: (view, at) => view.getInt8(at),
  u1: (view, at) => view.getUint8(at),
  i2: (view, at, little) => view.getInt16(at, little),
  u2: (view, at, little) => view.getUint16(at, little),
  i4: (view, at, little) => view.getInt32(at, little),
  u4: (view, at, little) => view.getUint32(at, little),
  f4: (view, at, little) => view.getFloat32(at, little),
  f8: (view, at, little) => view.getFloat64(at, little),
  i8: (view, at, little) => Number(view.getBigInt64(at, little)),
  u8: (view, at, little) => Number(view.getBigUint64(at, little)),
};

/** Rows of text, one per line; blank lines do not count. */
function readText(bytes: Uint8Array, header: PlyHeader, targets: (Target | undefined)[]): void {
  let before = 0;
  for (const element of header.elements) {
    if (element === header.vertex) break;
    if (element.properties.length) before += element.count;
  }
  const { count, properties } = header.vertex;
  let at = header.offset;
  let row = -before;
  while (row < count) {
    if (at >= bytes.length) throw new Unreadable(`The file ends after ${Math.max(row, 0)} points.`);
    let end = at;
    while (end < bytes.length && bytes[end] !== 10 && bytes[end] !== 13) end++;
    let word = skip(bytes, at, end);
    if (word < end) {
      if (row >= 0) {
        for (let index = 0; index < properties.length && word < end; index++) {
          const stop = wordEnd(bytes, word, end);
          const target = targets[index];
          if (properties[index]?.length) {
            let left = numberIn(bytes, word, stop);
            word = skip(bytes, stop, end);
            for (; left > 0 && word < end; left--) word = skip(bytes, wordEnd(bytes, word, end), end);
            continue;
          }
          if (target) target.values[3 * row + target.place] = numberIn(bytes, word, stop);
          word = skip(bytes, stop, end);
        }
      }
      row++;
    }
    at = end + 1;
  }
}

function skip(bytes: Uint8Array, from: number, to: number): number {
  let at = from;
  while (at < to && (bytes[at] === 32 || bytes[at] === 9)) at++;
  return at;
}

function wordEnd(bytes: Uint8Array, from: number, to: number): number {
  let at = from;
  while (at < to && bytes[at] !== 32 && bytes[at] !== 9) at++;
  return at;
}
