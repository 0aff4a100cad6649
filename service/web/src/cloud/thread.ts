// The page's side of the second thread.

import type { Cloud, Triple } from './cloud.ts';
import { Unreadable } from './reading.ts';
import type { Reply, Request } from './worker.ts';

/** Larger files are not held in a browser's memory; they can be uploaded all the same. */
export const SHOWN_BYTES = 2 ** 30;

let worker: Worker | null = null;
let number = 0;
const waiting = new Map<number, { resolve: (value: never) => void; reject: (error: Error) => void }>();

function ask<T>(request: Request, transfer: Transferable[] = []): Promise<T> {
  if (!worker) {
    worker = new Worker(new URL('./worker.ts', import.meta.url), { type: 'module' });
    worker.onmessage = ({ data }: MessageEvent<Reply>) => {
      const who = waiting.get(data.number);
      waiting.delete(data.number);
      if ('unreadable' in data) who?.reject(new Unreadable(data.unreadable));
      else who?.resolve(data.result as never);
    };
    worker.onerror = () => {
      // Out of memory, most likely: whoever waits is told, and the next one gets a new thread.
      for (const who of waiting.values()) who.reject(new Unreadable('The browser ran out of memory.'));
      waiting.clear();
      worker = null;
    };
  }
  const thread = worker;
  return new Promise((resolve, reject) => {
    waiting.set(++number, { resolve, reject });
    thread.postMessage({ ...request, number }, transfer);
  });
}

/** The points of a file, thinned for display; rejects with Unreadable. */
export function readFile(file: Blob): Promise<Cloud> {
  if (file.size > SHOWN_BYTES) {
    return Promise.reject(new Unreadable('Files above 1 GiB are not shown here; they can be uploaded all the same.'));
  }
  return ask({ task: 'read', file });
}

/** Distance of each vertex (n, 3), relative to `middle`, to the nearest point of the last cloud. */
export function distancesOf(vertices: Float32Array, middle: Triple): Promise<Float32Array> {
  const copy = vertices.slice();
  return ask({ task: 'distances', vertices: copy, middle }, [copy.buffer]);
}
