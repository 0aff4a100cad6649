// Which page: told by what stands behind the #, which never reaches the server or its logs.

import { computed, signal } from '@preact/signals';

export type Route =
  | { page: 'new' }
  | { page: 'jobs' }
  | { page: 'job'; id: string }
  | { page: 'shared'; token: string };

const hash = signal(location.hash);
addEventListener('hashchange', () => (hash.value = location.hash));

export const route = computed<Route>(() => {
  const [page, rest] = hash.value.replace(/^#\/?/, '').split('/');
  if (page === 'jobs' && rest) return { page: 'job', id: rest };
  if (page === 'jobs') return { page: 'jobs' };
  if (page === 'shared' && rest) return { page: 'shared', token: rest };
  return { page: 'new' };
});

export function go(to: string): void {
  location.hash = to;
}
