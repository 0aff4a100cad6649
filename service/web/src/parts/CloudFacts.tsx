// What the page found in the file.

import { reading, shown } from '../state/cloud.ts';
import { bytes, count } from '../state/format.ts';
import { length, unit, UNITS } from '../state/unit.ts';

export function CloudFacts() {
  const now = shown.value;
  if (!now) return null;
  const { cloud, file, note } = now;
  return (
    <section class="facts" aria-label="The cloud" aria-live="polite">
      {file && <h2>{file.name} <small>{bytes(file.size)}</small></h2>}
      {reading.value && !cloud && !note && <p>Reading the points …</p>}
      {note && <p class="note">Not shown: {note}</p>}
      {cloud && (
        <>
          <dl>
            <dt>Points</dt>
            <dd>{count(cloud.count)}{cloud.colors ? ', with colours' : ''}</dd>
            <dt>Extents</dt>
            <dd>{cloud.high.map((high, k) => length(high - (cloud.low[k] as number))).join(' × ')}</dd>
            <dt>Read as</dt>
            <dd>{cloud.dialect}</dd>
          </dl>
          {cloud.shown < cloud.count && (
            <p class="note">
              {count(cloud.shown)} of {count(cloud.count)} points are drawn, evenly thinned. All of them are used.
            </p>
          )}
          {cloud.dropped > 0 && <p class="note">{count(cloud.dropped)} rows are not finite numbers.</p>}
          <UnitChoice />
        </>
      )}
    </section>
  );
}

function UnitChoice() {
  return (
    <label class="unit">
      Unit of the coordinates{' '}
      <select value={unit.value} onChange={(event) => (unit.value = event.currentTarget.value)}>
        {Object.keys(UNITS).map((name) => <option key={name} value={name}>{name || 'not told'}</option>)}
      </select>
    </label>
  );
}

