// One plane for both: the surface is clipped at it, and the field is shown on it.

import { useSignal } from '@preact/signals';
import { useEffect } from 'preact/hooks';

import type { Job } from '../api/client.ts';
import { pictureBlob, pictureUrl } from '../api/pictures.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { stackOf, type Stack } from '../state/slices.ts';
import { figure, length } from '../state/unit.ts';
import * as view from '../state/view.ts';
import { AXES, type Axis, type Slice } from '../view/axes.ts';
import type { Placed } from '../view/slice.ts';
import { Notice } from './Notice.tsx';

const FIELDS: [string, string][] = [
  ['phi', 'φ: r·P + θ, zero on the surface'],
  ['r', 'r: distance without sign'],
  ['theta', 'θ: signed, through the surface'],
  ['P', 'P: phase, which side'],
];

interface Props {
  job: Job;
  base: string;
  /** Those of φ that came with the job. */
  slices: Slice[];
  own: boolean;
}

export function CutPanel({ job, base, slices, own }: Props) {
  const stack = useSignal<Stack>({ slices, base });
  const field = useSignal(slices[0]?.field ?? 'phi');
  const axis = useSignal<Axis>('y');
  const place = useSignal(0.5);
  const clips = useSignal(false);
  const slicing = useSignal(false);
  const busy = useSignal(false);
  const problem = useSignal<Problem | null>(null);

  const those = stack.value.slices.filter((one) => one.axis === axis.value && one.field === field.value);
  const index = Math.min(those.length - 1, Math.max(0, Math.round(place.value * (those.length - 1))));
  const slice = those[index];

  useEffect(() => {
    view.clip.value = clips.value && slice ? { axis: axis.value, at: slice.at } : null;
  }, [clips.value, slice]);
  useEffect(() => {
    if (!slicing.value || !slice) {
      view.slice.value = null;
      return undefined;
    }
    let current = true;
    void lay(slice, stack.value.base).then((laid) => {
      if (current) view.slice.value = laid;
      else laid?.picture.close();
    });
    return () => (current = false);
  }, [slicing.value, slice]);

  const choose = async (name: string) => {
    problem.value = null;
    if (name === (slices[0]?.field ?? '')) stack.value = { slices, base };
    else {
      busy.value = true;
      try {
        stack.value = await stackOf(job, name);
      } catch (error) {
        problem.value = problemOf(error);
        return;
      } finally {
        busy.value = false;
      }
    }
    field.value = name;
    slicing.value = true;
  };

  if (slices.length === 0 && !own) return null;
  return (
    <fieldset class="cut">
      <legend>Cut</legend>
      <div class="row" role="radiogroup" aria-label="Across">
        {AXES.map((name) => (
          <label key={name} class="check">
            <input type="radio" name="axis" checked={axis.value === name} onChange={() => (axis.value = name)} /> across {name}
          </label>
        ))}
      </div>
      <label class="slider">
        <span>{slice ? `${axis.value} = ${length(slice.at)}` : 'no slices here'}</span>
        <input
          type="range" min={0} max={Math.max(0, those.length - 1)} value={index} disabled={!slice} aria-label="Position"
          aria-valuetext={slice ? `${axis.value} = ${figure(slice.at)}` : ''}
          onInput={(event) => (place.value = Number(event.currentTarget.value) / Math.max(1, those.length - 1))}
        />
      </label>
      <div class="row">
        <label class="check">
          <input type="checkbox" checked={clips.value} onChange={(event) => (clips.value = event.currentTarget.checked)} /> Clip the view here
        </label>
        <label class="check">
          <input type="checkbox" checked={slicing.value} onChange={(event) => (slicing.value = event.currentTarget.checked)} /> Show the field here
        </label>
      </div>
      <label class="field-choice">
        Field{' '}
        <select value={field.value} disabled={busy.value} onChange={(event) => void choose(event.currentTarget.value)}>
          {FIELDS.filter(([name]) => own || slices.some((one) => one.field === name)).map(([name, title]) => (
            <option key={name} value={name}>{title}</option>
          ))}
        </select>
      </label>
      {busy.value && <p role="status">The slices are being drawn; this takes some seconds …</p>}
      {problem.value && <Notice problem={problem.value} />}
      {slicing.value && slice && <Picture slice={slice} base={stack.value.base} />}
    </fieldset>
  );
}

function Picture({ slice, base }: { slice: Slice; base: string }) {
  const url = useSignal('');
  useEffect(() => {
    let current = true;
    pictureUrl(`${base}/${slice.file}`).then((found) => current && (url.value = found)).catch(() => {});
    return () => (current = false);
  }, [slice, base]);
  return url.value ? (
    <img class="slice" src={url.value} alt={`${slice.field} on the plane ${slice.axis} = ${figure(slice.at)}`} />
  ) : null;
}

/** The picture ready to be laid into the view; null where it is not known where it lies. */
async function lay(slice: Slice, base: string): Promise<{ slice: Placed; picture: ImageBitmap } | null> {
  if (!slice.extent || !slice.plot) return null;
  const picture = await createImageBitmap(await pictureBlob(`${base}/${slice.file}`));
  return { slice: slice as Placed, picture };
}
