// The terms of the loss over the iterations: small, so drawn as SVG by hand.

import type { Point } from '../state/history.ts';

const WIDTH = 320;
const HEIGHT = 132;
const LEFT = 34;
const BOTTOM = 18;
const RIGHT = 6;
const TOP = 6;

/** Order of colours and names; further terms follow. */
const NAMES: Record<string, string> = {
  total: 'total', zero: 'surface', zero_level: 'surface', align: 'align', eik_r: 'Eikonal r',
  eik_phi: 'Eikonal φ', lap: 'Laplacian', phase: 'phase', phase_sat: 'phase', far: 'far field',
  far_field: 'far field', normal: 'normals', start: 'warm start',
};

export function Losses({ points }: { points: Point[] }) {
  const shown = points.filter((p) => p.iteration > 0);
  if (shown.length < 2) return null;
  const names = [...new Set(shown.flatMap((p) => Object.keys(p.terms)))];
  const lines = names
    .map((name) => ({ name, at: shown.flatMap((p) => spot(p, name)) }))
    .filter(({ at }) => at.length > 1);
  const values = lines.flatMap(({ at }) => at.map(([, value]) => value));
  const low = Math.max(Math.floor(Math.min(...values)), -9);
  const high = Math.max(Math.ceil(Math.max(...values)), low + 1);
  const last = shown.at(-1)?.iteration ?? 1;
  const x = (iteration: number) => LEFT + ((WIDTH - LEFT - RIGHT) * iteration) / last;
  const y = (value: number) => TOP + ((HEIGHT - TOP - BOTTOM) * (high - Math.max(low, value))) / (high - low);
  const decades = Array.from({ length: high - low + 1 }, (_, k) => low + k).filter(
    (_, k) => k % Math.ceil((high - low) / 5) === 0,
  );
  const total = shown.at(-1)?.terms['total'];
  return (
    <figure class="losses">
      <figcaption>Loss over {last.toLocaleString('en')} iterations</figcaption>
      <svg
        viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
        role="img"
        aria-label={`Curves of ${lines.length} loss terms; the total is ${total?.toPrecision(3) ?? 'not told'} now`}
      >
        {decades.map((decade) => (
          <g key={decade}>
            <line class="grid" x1={LEFT} x2={WIDTH - RIGHT} y1={y(decade)} y2={y(decade)} />
            <text x={LEFT - 4} y={y(decade) + 3} text-anchor="end">1e{decade}</text>
          </g>
        ))}
        <text x={WIDTH - RIGHT} y={HEIGHT - 4} text-anchor="end">iteration {last}</text>
        {lines.map(({ name, at }, k) => (
          <path key={name} class={`term term-${k % 10}`} d={at.map(([i, v], n) => `${n ? 'L' : 'M'}${x(i).toFixed(1)} ${y(v).toFixed(1)}`).join('')} />
        ))}
      </svg>
      <ul>
        {lines.map(({ name }, k) => (
          <li key={name}><i class={`swatch term-${k % 10}`} aria-hidden="true" />{NAMES[name] ?? name}</li>
        ))}
      </ul>
    </figure>
  );
}

/** Iteration and power of ten of a term, if it is there and above zero. */
function spot(point: Point, name: string): [number, number][] {
  const value = point.terms[name];
  return value !== undefined && value > 0 ? [[point.iteration, Math.log10(value)]] : [];
}
