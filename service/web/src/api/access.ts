// The API key: kept for this tab, or on this device if its owner wants that.

import { signal } from '@preact/signals';

const NAME = 'mpf.key';

export const key = signal<string>(sessionStorage.getItem(NAME) ?? localStorage.getItem(NAME) ?? '');
export const remembered = signal<boolean>(localStorage.getItem(NAME) !== null);

export function useKey(value: string, remember: boolean): void {
  key.value = value;
  remembered.value = remember && value !== '';
  sessionStorage.removeItem(NAME);
  localStorage.removeItem(NAME);
  if (value) (remember ? localStorage : sessionStorage).setItem(NAME, value);
}

export function authorization(): Record<string, string> {
  return key.value ? { Authorization: `Bearer ${key.value}` } : {};
}
