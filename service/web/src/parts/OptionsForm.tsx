// Options that a person understands; the rest is folded away. All of it is made of the service's
// schema, so that it cannot drift.

import type { Signal } from '@preact/signals';

import type { Capabilities, Options } from '../api/client.ts';
import { costOf } from '../state/cost.ts';
import { seconds } from '../state/format.ts';
import { optionsIn, type Option } from '../state/schema.ts';
import { OptionField } from './OptionField.tsx';

const FIRST = ['resolution', 'max_iterations', 'seed'];
const ABOUT: Record<string, string> = {
  draft: 'A first look.',
  balanced: 'The default.',
  paper: 'The paper’s recipe and nothing else; days on a CPU.',
};
const GROUPS: Record<string, string> = { fit: 'Fit', surface: 'Surface', data: 'Data', job: 'Job' };

interface Props {
  service: Capabilities;
  values: Signal<Options>;
}

export function OptionsForm({ service, values }: Props) {
  const preset = String(values.value['preset'] ?? 'balanced');
  const defaults = service.presets[preset] ?? {};
  const options = optionsIn(service.options).filter(({ name }) => name !== 'preset');
  const field = (option: Option, title?: string) => (
    <OptionField
      key={option.name} option={option} {...(title && { title })} preset={defaults[option.name]}
      value={values.value[option.name]}
      onChange={(value) => (values.value = { ...values.value, [option.name]: value })}
    />
  );
  const first = FIRST.flatMap((name) => options.filter((option) => option.name === name));
  const rest = options.filter(({ name }) => !FIRST.includes(name));
  return (
    <div class="options">
      <Presets service={service} values={values} preset={preset} />
      {first.map((option) => field(option, option.name === 'max_iterations' ? 'most iterations' : undefined))}
      <details>
        <summary>More options</summary>
        {rest.filter(({ expert }) => !expert).map((option) => field(option))}
      </details>
      <details>
        <summary>For experts</summary>
        {Object.entries(GROUPS).map(([group, title]) => {
          const those = rest.filter((option) => option.expert && option.group === group);
          return those.length > 0 && (
            <fieldset key={group}>
              <legend>{title}</legend>
              {those.map((option) => field(option))}
            </fieldset>
          );
        })}
      </details>
    </div>
  );
}

function Presets({ service, values, preset }: Props & { preset: string }) {
  return (
    <fieldset class="presets">
      <legend>Preset</legend>
      {Object.keys(service.presets).map((name) => (
        <label key={name} class={name === preset ? 'chosen' : ''}>
          <input
            type="radio" name="preset" value={name} checked={name === preset}
            onChange={() => (values.value = { ...values.value, preset: name })}
          />
          <span>
            <strong>{name}</strong> {ABOUT[name]}
            <small>{price(service, { ...service.presets[name], ...chosen(values.value) })}</small>
          </span>
        </label>
      ))}
    </fieldset>
  );
}

/** Those that were chosen by hand, whatever the preset. */
function chosen(values: Options): Options {
  return Object.fromEntries(Object.entries(values).filter(([k, v]) => k !== 'preset' && v !== undefined));
}

function price(service: Capabilities, options: Options): string {
  const cost = costOf(options, service.rate?.points_per_second ?? null);
  if (cost.seconds === null) return `at most ${seconds(cost.most)}; not measured here yet`;
  if (cost.seconds >= cost.most) return `stops after ${seconds(cost.most)}, at this server’s speed`;
  return `about ${seconds(cost.seconds)} at this server’s speed, at most ${seconds(cost.most)}`;
}
