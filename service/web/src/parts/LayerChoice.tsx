// Which layers are drawn, and what the surface's colours tell.

import { useSignal } from '@preact/signals';

import { distancesOf } from '../cloud/thread.ts';
import { shown } from '../state/cloud.ts';
import * as view from '../state/view.ts';
import { quantile } from '../view/colors.ts';
import type { Layers } from '../view/viewer.ts';

const NAMES: [keyof Layers, string][] = [['points', 'Points'], ['surface', 'Surface'], ['wireframe', 'Edges']];
/** Beyond this share of the vertices colours do not change: a single bridge would take them all. */
const SHARE = 0.98;

export function LayerChoice() {
  const busy = useSignal(false);
  const points = shown.value?.cloud;
  const color = async (on: boolean) => {
    const surface = view.surface.value;
    if (!on || !surface) {
      view.paint.value = null;
      return;
    }
    busy.value = true;
    try {
      const values = await distancesOf(surface.vertices, surface.middle);
      view.paint.value = { values, limit: quantile(values, SHARE) || 1e-12 };
      view.layers.value = { ...view.layers.value, points: false, surface: true };
    } finally {
      busy.value = false;
    }
  };
  return (
    <fieldset class="layers">
      <legend>Show</legend>
      {NAMES.map(([name, title]) => (
        <label key={name} class="check">
          <input
            type="checkbox" checked={view.layers.value[name]} disabled={name === 'points' && !points}
            onChange={(event) => (view.layers.value = { ...view.layers.value, [name]: event.currentTarget.checked })}
          />{' '}
          {title}
        </label>
      ))}
      <label class="check">
        <input
          type="checkbox" checked={view.paint.value !== null || busy.value} disabled={!points || !view.surface.value || busy.value}
          onChange={(event) => void color(event.currentTarget.checked)}
        />{' '}
        {busy.value ? 'Measuring …' : 'Distance to the input'}
      </label>
    </fieldset>
  );
}
