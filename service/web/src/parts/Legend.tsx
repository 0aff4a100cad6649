// What the colours of the surface mean.

import { paint } from '../state/view.ts';
import { length } from '../state/unit.ts';
import { SCALE } from '../view/colors.ts';

export function Legend() {
  if (!paint.value) return null;
  const { limit } = paint.value;
  return (
    <figure class="legend">
      <figcaption>Distance of the surface to the nearest input point</figcaption>
      <svg viewBox="0 0 160 10" role="img" aria-label={`Dark is 0, yellow is ${length(limit)} or more`}>
        <defs>
          <linearGradient id="scale">
            {SCALE.map((color, k) => (
              <stop offset={k / (SCALE.length - 1)} stop-color={color} />
            ))}
          </linearGradient>
        </defs>
        <rect width="160" height="10" fill="url(#scale)" />
      </svg>
      <p>
        <span>0</span>
        <span>{length(limit / 2)}</span>
        <span>≥ {length(limit)}</span>
      </p>
    </figure>
  );
}
