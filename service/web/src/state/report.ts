// The report, as far as the page reads it, and what it says in words.

import { count, plural, seconds } from './format.ts';
import { length, unit } from './unit.ts';
import type { Slice } from '../view/axes.ts';

export interface Report {
  surface?: {
    faces: number;
    vertices: number;
    components: number;
    boundary_loops: number;
    nonmanifold_edges: number;
    self_intersections: number | null;
    watertight: boolean;
    area: number;
    volume: number | null;
    extents: number[];
    input_to_surface: { median: number; p95: number; max: number };
  };
  fit?: { iterations: number; planned_iterations: number; stopped_by: string; seconds: number; notes: string[] };
  input?: { points: number; used: number; notes: string[] };
  extraction?: Record<string, unknown>;
  timings?: Record<string, number>;
  slices?: Slice[];
}

const STOPS: Record<string, string> = {
  iterations: 'as many as were asked for',
  plateau: 'then it became no better',
  clock: 'then its time was up',
  cancel: 'then it was told that this is good enough',
};

/** One line: “closed, 1 component, 0.4 mm median distance”. */
export function headline({ surface }: Report): string {
  if (!surface) return 'Slices only';
  const parts = [
    surface.watertight ? 'Closed' : surface.boundary_loops ? `Open, with ${plural(surface.boundary_loops, 'rim')}` : 'Not closed',
    plural(surface.components, 'component'),
    `${length(surface.input_to_surface.median)} median distance`,
  ];
  return parts.join(', ');
}

export function sentences({ surface, fit, input, timings }: Report): string[] {
  const said: string[] = [];
  if (surface) {
    const { input_to_surface: distance } = surface;
    said.push(
      `Half of the input points lie within ${length(distance.median)} of the surface, 95 % within ${length(distance.p95)}; the farthest is ${length(distance.max)} away.`,
      `It has ${plural(surface.faces, 'triangle')} and measures ${surface.extents.map(length).join(' × ')}${surface.volume === null ? '' : `; it encloses ${power(surface.volume, 3)}`}.`,
    );
    if (surface.self_intersections) said.push(`${plural(surface.self_intersections, 'pair')} of its triangles cross each other.`);
    else if (surface.self_intersections === 0) said.push('None of its triangles cross each other.');
    if (surface.nonmanifold_edges) said.push(`${plural(surface.nonmanifold_edges, 'edge')} have more than two triangles.`);
  }
  if (input && input.used < input.points) said.push(`${count(input.used)} of ${count(input.points)} points were used.`);
  if (fit) {
    said.push(`The fit took ${plural(fit.iterations, 'iteration')} in ${seconds(fit.seconds)}: ${STOPS[fit.stopped_by] ?? fit.stopped_by}.`);
  }
  if (timings) {
    const all = Object.values(timings).reduce((sum, one) => sum + one, 0);
    said.push(`All of it took ${seconds(all)}.`);
  }
  return said;
}

function power(value: number, exponent: 2 | 3): string {
  const sign = exponent === 2 ? '²' : '³';
  return `${value.toPrecision(3).replace('-', '−')} ${unit.value || 'unit'}${sign}`;
}
