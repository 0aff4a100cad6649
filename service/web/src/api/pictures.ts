// Files that may need the key, as addresses that <img> and <a download> can use.

import { key } from './access.ts';
import { file } from './client.ts';

const MOST = 200;
const made = new Map<string, Promise<string>>();

/** A blob: address of a picture that never changes, kept for a while. */
export function pictureUrl(href: string): Promise<string> {
  const known = made.get(href);
  if (known) return known;
  const fresh = pictureBlob(href).then((blob) => URL.createObjectURL(blob));
  made.set(href, fresh);
  fresh.catch(() => made.delete(href));
  if (made.size > MOST) {
    const [oldest, address] = made.entries().next().value as [string, Promise<string>];
    made.delete(oldest);
    void address.then((url) => URL.revokeObjectURL(url));
  }
  return fresh;
}

export async function pictureBlob(href: string): Promise<Blob> {
  return (await file(href)).blob();
}

/** Save a file. Without a key the browser fetches it by itself, however large it is. */
export async function download(href: string, name: string): Promise<void> {
  if (!key.value || href.startsWith('/shared/')) return save(href, name);
  const url = URL.createObjectURL(await pictureBlob(href));
  save(url, name);
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

function save(href: string, name: string): void {
  const link = document.createElement('a');
  link.href = href;
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
}
