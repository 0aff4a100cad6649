// Clouds for a first try, made here: nothing has to be shipped or fetched. All are thin things, which
// is what the method is for, with a little noise, in metres.

import type { Triple } from './cloud.ts';

export interface Sample {
  name: string;
  about: string;
  points: number;
  /** A point of the surface and its colour (0..1) for a random (u, v, w) in [0, 1)³. */
  at: (u: number, v: number, w: number) => { point: Triple; color: Triple };
}

const TURN = 2 * Math.PI;

/** Two walls a hand's breadth of noise apart: an open bowl with a thickness. */
function bowl(u: number, v: number, w: number): ReturnType<Sample['at']> {
  const wall = w < 0.5 ? 0 : 0.012;
  const radius = 0.16 - wall;
  const height = 1 - v * 0.95; // uniform on the sphere's cap
  const ring = Math.sqrt(Math.max(0, 1 - height * height));
  const angle = TURN * u;
  const glaze = 0.5 + 0.5 * Math.cos(6 * angle + 9 * height);
  return {
    point: [radius * ring * Math.cos(angle), radius * ring * Math.sin(angle), 0.16 - radius * height],
    color: wall ? [0.86, 0.8, 0.7] : [0.16 + 0.3 * glaze, 0.42 + 0.2 * glaze, 0.55],
  };
}

/** One layer: a curled leaf with an open rim. */
function leaf(u: number, v: number): ReturnType<Sample['at']> {
  const along = v;
  const half = 0.045 * Math.sin(Math.PI * along) ** 0.7 * (1 + 0.12 * Math.sin(34 * along));
  const side = 2 * u - 1;
  const across = half * side;
  const droop = 0.06 * Math.sin(1.6 * along) - 3.2 * across * across + 0.0025 * Math.cos(26 * along) * side * side;
  const vein = Math.exp(-((side / 0.05) ** 2)) + 0.35 * Math.max(0, Math.cos(44 * (along - 0.22 * Math.abs(side)))) ** 12;
  return {
    point: [across, 0.18 * along - 0.09, droop],
    color: [0.2 + 0.4 * vein, 0.45 + 0.3 * vein, 0.16 + 0.2 * vein],
  };
}

/** A closed tube that winds around itself twice and thrice. */
function knot(u: number, v: number): ReturnType<Sample['at']> {
  const center = (t: number): Triple => {
    const ring = 0.1 + 0.04 * Math.cos(3 * t);
    return [ring * Math.cos(2 * t), ring * Math.sin(2 * t), 0.05 * Math.sin(3 * t)];
  };
  const t = TURN * u;
  const here = center(t);
  const ahead = center(t + 1e-3);
  const along = unit(here.map((value, k) => (ahead[k] as number) - value) as Triple);
  const side = unit(cross(along, [here[0], here[1], 0]));
  const up = cross(side, along);
  const angle = TURN * v;
  const [a, b] = [0.022 * Math.cos(angle), 0.022 * Math.sin(angle)];
  return {
    point: here.map((value, k) => value + a * (side[k] as number) + b * (up[k] as number)) as Triple,
    color: [0.5 + 0.4 * Math.cos(t), 0.45 + 0.25 * Math.cos(t + 2.1), 0.5 + 0.4 * Math.cos(t + 4.2)],
  };
}

export const SAMPLES: Sample[] = [
  { name: 'bowl', about: 'two walls, 12 mm apart', points: 24_000, at: bowl },
  { name: 'leaf', about: 'one layer with an open rim', points: 16_000, at: leaf },
  { name: 'knot', about: 'a closed tube', points: 24_000, at: knot },
];

/** The sample as a binary PLY file, the same every time. */
export function sampleFile(sample: Sample): ArrayBuffer {
  const properties = ['float x', 'float y', 'float z', 'uchar red', 'uchar green', 'uchar blue'];
  const lines = [
    'ply', 'format binary_little_endian 1.0', `element vertex ${sample.points}`,
    ...properties.map((p) => `property ${p}`), 'end_header', '',
  ];
  const header = new TextEncoder().encode(lines.join('\n'));
  const buffer = new ArrayBuffer(header.length + 15 * sample.points);
  new Uint8Array(buffer).set(header);
  const view = new DataView(buffer, header.length);
  const random = generator(7);
  for (let i = 0; i < sample.points; i++) {
    const { point, color } = sample.at(random(), random(), random());
    point.forEach((value, k) => view.setFloat32(15 * i + 4 * k, value + 0.0003 * (random() - 0.5), true));
    color.forEach((value, k) => view.setUint8(15 * i + 12 + k, Math.round(255 * Math.min(1, Math.max(0, value)))));
  }
  return buffer;
}

/** Mulberry32: a small generator that gives the same everywhere. */
function generator(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function unit([x, y, z]: Triple): Triple {
  const length = Math.hypot(x, y, z);
  return [x / length, y / length, z / length];
}

function cross([a, b, c]: Triple, [x, y, z]: Triple): Triple {
  return [b * z - c * y, c * x - a * z, a * y - b * x];
}
