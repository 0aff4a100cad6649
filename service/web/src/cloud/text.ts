// Rows of numbers: .xyz, .txt, .csv, .pts, .asc. What the columns are is told by a header, or
// guessed by the rules of docs/formats.md.

import { hasAll, rolesOf, type Role, type Roles } from './columns.ts';
import { numberIn } from './numbers.ts';
import { toBytes, Unreadable, type Reading } from './reading.ts';

const COORDINATES: Role[] = ['x', 'y', 'z'];
const COLORS: Role[] = ['red', 'green', 'blue'];
const MOST_COLUMNS = 12; // that are looked at
const BLANK = new Set([32, 9]);

interface Head {
  offset: number;
  columns: number;
  /** Bytes between two numbers. */
  delimiters: Set<number>;
  comma: boolean;
  names: string[] | null;
  declared: number | null;
}

export function readText(bytes: Uint8Array): Reading {
  const head = readHead(bytes);
  const table = readRows(bytes, head);
  const rows = table.length / head.columns;
  const roles = head.names ? rolesOf(head.names) : guessed(table, head.columns, rows);
  if (!hasAll(roles, COORDINATES)) throw new Unreadable('The header names no x, y and z.');
  const points = new Float64Array(3 * rows);
  copy(table, head.columns, rows, COORDINATES.map((r) => roles[r] as number), points);
  let colors: Uint8Array | null = null;
  if (hasAll(roles, COLORS)) {
    const values = new Float32Array(3 * rows);
    copy(table, head.columns, rows, COLORS.map((r) => roles[r] as number), values);
    const whole = values.every(Number.isInteger) && values.some((value) => value > 1);
    colors = toBytes(values, whole);
  }
  return { points, colors, dialect: `text, ${head.columns} columns` };
}

function copy(
  table: Float64Array, columns: number, rows: number, from: number[], to: Float64Array | Float32Array,
): void {
  for (let row = 0; row < rows; row++) {
    for (let k = 0; k < 3; k++) to[3 * row + k] = table[row * columns + (from[k] as number)] as number;
  }
}

function readHead(bytes: Uint8Array): Head {
  let at = bytes[0] === 0xef && bytes[1] === 0xbb && bytes[2] === 0xbf ? 3 : 0;
  const decoder = new TextDecoder();
  let declared: number | null = null;
  let header: string | null = null;
  for (let line = 0; line < 10_000 && at < bytes.length; line++) {
    let end = at;
    while (end < bytes.length && bytes[end] !== 10 && bytes[end] !== 13) end++;
    const text = decoder.decode(bytes.subarray(at, end)).trim();
    const comment = /^(#|\/\/|%|!)/.test(text);
    const fields = fieldsOf(comment ? '' : text);
    if (fields && fields.words.length >= 3) {
      const names = header === null ? null : namesIn(header, fields.words.length);
      return { offset: at, columns: fields.words.length, ...fields, names, declared };
    }
    if (fields && fields.words.length === 1 && /^\d+$/.test(text) && declared === null) {
      declared = Number(text);
    } else if (/[a-z]/i.test(text)) header = comment ? text.replace(/^(#|\/\/|%|!)+/, '') : text;
    else if (text && !comment) throw new Unreadable(strange(text));
    at = end + 1;
  }
  throw new Unreadable('There are no rows of numbers in this file.');
}

function strange(line: string): string {
  const printable = !/[\u0000-\u0008\u000e-\u001f\ufffd]/.test(line);
  return printable
    ? `“${line.slice(0, 40)}” is no row of numbers.`
    : 'This is neither PLY nor text with rows of numbers.';
}

interface Fields {
  words: string[];
  delimiters: Set<number>;
  comma: boolean;
}

/** The words of a row and how they are parted; null if they are not all numbers. */
function fieldsOf(text: string): Fields | null {
  const styles: [RegExp, number[], boolean][] = text.includes(';')
    ? [[/[\s;]+/, [59], true]]
    : [[/[\s,]+/, [44], false], [/\s+/, [], true]];
  // “1,5 2,5 3,5” has blanks between numbers with decimal commas, and commas only within words.
  if (/^[+-]?\d+,\d+(\s+[+-]?\d+,\d+)+$/.test(text)) styles.reverse();
  for (const [between, bytes, comma] of styles) {
    const words = text.split(between).filter((word) => word !== '');
    if (words.length && words.every((word) => isNumber(word, comma))) {
      return { words, delimiters: new Set([...BLANK, ...bytes]), comma };
    }
  }
  return null;
}

function isNumber(word: string, comma: boolean): boolean {
  const mended = (comma ? word.replace(',', '.') : word).replace(/d/i, 'e');
  return /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(mended) || /^[+-]?(nan|inf)/i.test(word);
}

function namesIn(header: string, columns: number): string[] | null {
  const parted = /[,;\t]/.test(header) ? header.split(/[,;\t]/) : header.trim().split(/\s+/);
  const names = parted.map((name) => name.trim()).filter((name) => name !== '');
  return names.length === columns && hasAll(rolesOf(names), COORDINATES) ? names : null;
}

function readRows(bytes: Uint8Array, head: Head): Float64Array {
  const { columns, delimiters, comma, declared } = head;
  const between = new Uint8Array(256);
  for (const byte of delimiters) between[byte] = 1;
  let table = new Float64Array(columns * Math.max(1024, Math.ceil(bytes.length / (columns * 4))));
  let used = 0;
  let at = head.offset;
  const most = declared ? declared * columns : Infinity;
  while (at < bytes.length && used < most) {
    let filled = 0;
    const first = bytes[at] as number;
    const passedOver = first === 35 || first === 37 || first === 33 || first === 47;
    if (used + columns > table.length) {
      const larger = new Float64Array(2 * table.length);
      larger.set(table);
      table = larger;
    }
    for (;;) {
      while (between[bytes[at] as number]) at++;
      const from = at;
      while (at < bytes.length && bytes[at] !== 10 && bytes[at] !== 13 && !between[bytes[at] as number]) at++;
      if (at > from && filled < columns && !passedOver) {
        table[used + filled++] = numberIn(bytes, from, at, comma);
      }
      if (at >= bytes.length || bytes[at] === 10 || bytes[at] === 13) break;
    }
    at++;
    if (filled === columns) used += columns;
    else if (filled > 0) {
      throw new Unreadable(`Row ${used / columns + 1} has ${filled} columns instead of ${columns}.`);
    }
  }
  return table.subarray(0, used);
}

/** Roles by place and values: x, y, z first, then normals of unit length, colours, intensity. */
function guessed(table: Float64Array, columns: number, rows: number): Roles {
  const roles: Roles = { x: 0, y: 1, z: 2 };
  if (columns > MOST_COLUMNS) return roles;
  const step = Math.max(1, Math.floor(rows / 20_000)); // a look at so many is enough for a guess
  const every = (test: (row: number) => boolean): boolean => {
    for (let row = 0; row < rows; row += step) if (!test(row * columns)) return false;
    return rows > 0;
  };
  const value = (at: number): number => table[at] as number;
  const starts = Array.from({ length: Math.max(0, columns - 5) }, (_, k) => k + 3);
  const unit = starts.find((s) =>
    every((row) => Math.abs(Math.hypot(value(row + s), value(row + s + 1), value(row + s + 2)) - 1) < 0.02),
  );
  const free = starts.filter((s) => unit === undefined || Math.abs(s - unit) > 2);
  const within = (s: number, high: number): boolean =>
    every((row) => [0, 1, 2].every((k) => value(row + s + k) >= 0 && value(row + s + k) <= high));
  const whole = (s: number): boolean =>
    every((row) => [0, 1, 2].every((k) => Number.isInteger(value(row + s + k))));
  const found = free.filter((s) => within(s, 255) && whole(s) && !within(s, 1));
  let start = found[0] ?? free.find((s) => within(s, 1) && !whole(s));
  if (found.includes(3) && found.includes(4) && !every((row) => value(row + 6) === 255)) start = 4;
  if (start !== undefined) Object.assign(roles, { red: start, green: start + 1, blue: start + 2 });
  return roles;
}
