// What this service takes: asked once, and again when the key changes.

import { effect, signal } from '@preact/signals';

import { key } from '../api/access.ts';
import { capabilities, type Capabilities } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';

export const service = signal<Capabilities | null>(null);
export const refused = signal<Problem | null>(null);

const PAUSE_SECONDS = 3;
let round = 0;

export async function askService(): Promise<void> {
  const mine = ++round;
  try {
    service.value = await capabilities();
    refused.value = null;
  } catch (error) {
    if (mine !== round) return;
    refused.value = problemOf(error);
    if (refused.value.status === 0 || refused.value.status === 503) {
      setTimeout(() => mine === round && void askService(), PAUSE_SECONDS * 1000);
    }
  }
}

effect(() => {
  void key.value;
  void askService();
});
