// Dark or light: as the system has it, unless its user says otherwise here.

import { computed, effect, signal } from '@preact/signals';

const NAME = 'mpf.theme';
const CHOICES = ['system', 'light', 'dark'] as const;
export type Choice = (typeof CHOICES)[number];

const system = matchMedia('(prefers-color-scheme: dark)');
const systemDark = signal(system.matches);
system.addEventListener('change', () => (systemDark.value = system.matches));

const stored = localStorage.getItem(NAME) as Choice | null;
export const choice = signal<Choice>(stored && CHOICES.includes(stored) ? stored : 'system');
export const dark = computed(() =>
  choice.value === 'system' ? systemDark.value : choice.value === 'dark',
);

effect(() => {
  localStorage.setItem(NAME, choice.value);
  document.documentElement.dataset.theme = dark.value ? 'dark' : 'light';
});

export function nextTheme(): void {
  choice.value = CHOICES[(CHOICES.indexOf(choice.value) + 1) % CHOICES.length] as Choice;
}
