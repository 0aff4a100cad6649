// The options' JSON Schema, as far as a form needs it.

import type { Options } from '../api/client.ts';

export interface Option {
  name: string;
  type: 'integer' | 'number' | 'string' | 'boolean';
  optional: boolean;
  description: string;
  default: unknown;
  minimum?: number;
  maximum?: number;
  choices?: string[];
  unit?: string;
  group: string;
  expert: boolean;
}

type Raw = Record<string, unknown>;

export function optionsIn(schema: Raw): Option[] {
  return Object.entries((schema['properties'] ?? {}) as Record<string, Raw>).flatMap(([name, raw]) => {
    const types = [raw['type']].flat() as string[];
    const type = types.find((t) => t !== 'null') as Option['type'];
    if (!['integer', 'number', 'string', 'boolean'].includes(type)) return [];
    return [{
      name, type,
      optional: types.includes('null'),
      description: String(raw['description'] ?? ''),
      default: raw['default'],
      ...(raw['minimum'] !== undefined && { minimum: raw['minimum'] as number }),
      ...(raw['maximum'] !== undefined && { maximum: raw['maximum'] as number }),
      ...(raw['enum'] !== undefined && { choices: raw['enum'] as string[] }),
      ...(raw['x-unit'] !== undefined && { unit: raw['x-unit'] as string }),
      group: String(raw['x-group'] ?? ''),
      expert: raw['x-expert'] === true,
    }];
  });
}

/** The value that a field of the form holds; undefined where it holds none. */
export function valueOf(option: Option, text: string): unknown {
  if (option.type === 'boolean') return text === 'true';
  if (text.trim() === '') return undefined;
  return option.type === 'string' ? text : Number(text);
}

/** Options that differ from the preset's. */
export function changed(values: Options, preset: Options): Options {
  return Object.fromEntries(
    Object.entries(values).filter(([name, value]) => value !== undefined && value !== preset[name]),
  );
}
