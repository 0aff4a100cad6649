// What a fit is likely to take, from the rate at which this service has been fitting.

import type { Options } from '../api/client.ts';

/** Share of the time that is not the fit's own: reading, the warm start, the mesh, the report. */
const AROUND = 0.25;

export interface Cost {
  /** Expected, or null where the service has not fitted anything yet. */
  seconds: number | null;
  /** The cap: no fit takes longer. */
  most: number;
}

export function costOf(options: Options, pointsPerSecond: number | null): Cost {
  const number = (name: string) => Number(options[name] ?? 0);
  const most = number('time_budget');
  if (!pointsPerSecond) return { seconds: null, most };
  const step = number('surface_points') + number('near_points') + number('far_points');
  const fit = (number('max_iterations') * step) / pointsPerSecond;
  return { seconds: Math.min(most, fit * (1 + AROUND) + 3), most };
}
