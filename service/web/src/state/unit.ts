// Files do not say the unit of their coordinates; their owner may.

import { effect, signal } from '@preact/signals';

const NAME = 'mpf.unit';

/** Unit → its length in metres; '' where it is not told. */
export const UNITS: Record<string, number> = { '': 0, mm: 1e-3, cm: 1e-2, m: 1, km: 1e3, in: 0.0254, ft: 0.3048 };

const stored = localStorage.getItem(NAME) ?? '';
export const unit = signal<string>(stored in UNITS ? stored : '');
effect(() => localStorage.setItem(NAME, unit.value));

/** A length of the input, in its unit or a smaller or larger one of the same family. */
export function length(value: number): string {
  if (!unit.value) return figure(value);
  const metric: [string, number][] = [['km', 1e3], ['m', 1], ['cm', 1e-2], ['mm', 1e-3], ['µm', 1e-6]];
  if (!metric.some(([name]) => name === unit.value)) return `${figure(value)} ${unit.value}`;
  const metres = value * (UNITS[unit.value] as number);
  const fitting = metric.find(([name, size]) => name !== 'cm' && Math.abs(metres) >= size) ?? ['µm', 1e-6];
  return `${figure(metres / (fitting[1] as number))} ${fitting[0]}`;
}

/** Three significant digits, with a true minus sign. */
export function figure(value: number): string {
  if (!Number.isFinite(value)) return '–';
  const size = Math.abs(value);
  const text =
    size !== 0 && (size < 1e-4 || size >= 1e7)
      ? value.toExponential(2)
      : String(Number(size >= 1000 ? value.toFixed(0) : value.toPrecision(3)));
  return text.replace('-', '−');
}
