// One option as a field of a form, with its reason below it.

import { useId } from 'preact/hooks';

import { valueOf, type Option } from '../state/schema.ts';

interface Props {
  option: Option;
  title?: string;
  /** What holds if nothing is chosen. */
  preset: unknown;
  value: unknown;
  onChange: (value: unknown) => void;
}

export function OptionField({ option, title, preset, value, onChange }: Props) {
  const id = useId();
  const change = (event: Event) => {
    const field = event.currentTarget as HTMLInputElement | HTMLSelectElement;
    onChange(valueOf(option, field.value));
  };
  const choices = option.choices ?? (option.type === 'boolean' ? ['true', 'false'] : null);
  const shown = value ?? (choices ? preset : '');
  return (
    <div class="field">
      <label for={id}>
        {title ?? option.name.replaceAll('_', ' ')}
        {option.unit && <small> in {option.unit}</small>}
      </label>
      {choices ? (
        <select id={id} name={option.name} value={String(shown)} onChange={change} aria-describedby={`${id}-why`}>
          {choices.map((choice) => (
            <option key={choice} value={choice}>{choice === 'true' ? 'yes' : choice === 'false' ? 'no' : choice}</option>
          ))}
        </select>
      ) : (
        <input
          id={id} name={option.name} type="number" aria-describedby={`${id}-why`}
          min={option.minimum} max={option.maximum} step={option.type === 'integer' ? 1 : 'any'}
          value={String(shown)} placeholder={preset == null ? 'automatic' : String(preset)} onInput={change}
        />
      )}
      <p id={`${id}-why`}>{option.description}</p>
    </div>
  );
}
