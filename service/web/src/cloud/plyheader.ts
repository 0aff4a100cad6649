// The header of a PLY file: which elements, which properties, where the rows begin.

import { hasAll, rolesOf, type Roles } from './columns.ts';
import { Unreadable } from './reading.ts';

export type Kind = 'i1' | 'u1' | 'i2' | 'u2' | 'i4' | 'u4' | 'f4' | 'f8' | 'i8' | 'u8';

export const SIZES: Record<Kind, number> = {
  i1: 1, u1: 1, i2: 2, u2: 2, i4: 4, u4: 4, f4: 4, f8: 8, i8: 8, u8: 8,
};

const KINDS: Record<string, Kind> = {
  char: 'i1', uchar: 'u1', short: 'i2', ushort: 'u2', int: 'i4', uint: 'u4', float: 'f4',
  double: 'f8', int8: 'i1', uint8: 'u1', int16: 'i2', uint16: 'u2', int32: 'i4', uint32: 'u4',
  float32: 'f4', float64: 'f8', int64: 'i8', uint64: 'u8', bool: 'u1', long: 'i8', ulong: 'u8',
};

export interface Property {
  name: string;
  kind: Kind;
  /** Of a list: the type of its length. */
  length: Kind | null;
}

export interface Element {
  name: string;
  count: number;
  properties: Property[];
}

export interface PlyHeader {
  encoding: 'ascii' | 'binary_little_endian' | 'binary_big_endian';
  elements: Element[];
  /** The element that holds the points, and the roles of its properties. */
  vertex: Element;
  roles: Roles;
  /** Where the rows begin, bytes. */
  offset: number;
}

const LONGEST = 65536;

export function readHeader(bytes: Uint8Array): PlyHeader {
  const { lines, offset } = headerLines(bytes);
  let encoding: PlyHeader['encoding'] | null = null;
  const elements: Element[] = [];
  for (const line of lines.slice(1)) {
    const words = line.trim().split(/\s+/);
    if (words[0] === 'format') {
      const found = words[1];
      if (found !== 'ascii' && found !== 'binary_little_endian' && found !== 'binary_big_endian') {
        throw new Unreadable(`PLY knows no encoding “${found}”.`);
      }
      encoding = found;
    } else if (words[0] === 'element') {
      const count = Number(words[2]);
      if (!Number.isSafeInteger(count) || count < 0) throw new Unreadable(`“${line}” has no count.`);
      elements.push({ name: words[1] ?? '', count, properties: [] });
    } else if (words[0] === 'property') elements.at(-1)?.properties.push(propertyOf(words, line));
  }
  if (encoding === null) throw new Unreadable('The PLY header has no line “format”.');
  return { encoding, elements, offset, ...pointsOf(elements) };
}

function headerLines(bytes: Uint8Array): { lines: string[]; offset: number } {
  const text = new TextDecoder('latin1').decode(bytes.subarray(0, LONGEST));
  const end = /^end_header[ \t]*(\r\n|\n|\r)/m.exec(text);
  if (!end) throw new Unreadable('The PLY header has no end.');
  return { lines: text.slice(0, end.index).split(/\r\n|\n|\r/), offset: end.index + end[0].length };
}

function propertyOf(words: string[], line: string): Property {
  const list = words[1] === 'list';
  const kind = KINDS[words[list ? 3 : 1] ?? ''];
  const length = list ? KINDS[words[2] ?? ''] : null;
  if (!kind || length === undefined) throw new Unreadable(`PLY knows no type of “${line}”.`);
  return { name: words[list ? 4 : 2] ?? '', kind, length };
}

function pointsOf(elements: Element[]): { vertex: Element; roles: Roles } {
  const candidates = [...elements.filter((e) => e.name === 'vertex'), ...elements];
  for (const vertex of candidates) {
    const roles = rolesOf(vertex.properties.map((p) => (p.length ? '' : p.name)));
    if (hasAll(roles, ['x', 'y', 'z'])) return { vertex, roles };
  }
  throw new Unreadable('No element of the PLY file has x, y and z.');
}
