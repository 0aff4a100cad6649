// The page's second thread: reads clouds and keeps all their points, also those not drawn, so that
// distances are to the whole cloud.

import { centred, thinned, type Centred, type Cloud, type Triple } from './cloud.ts';
import { Nearest } from './nearest.ts';
import { readCloud } from './read.ts';
import { Unreadable } from './reading.ts';

export type Request =
  | { task: 'read'; file: Blob }
  /** vertices: (n, 3) relative to `middle`. */
  | { task: 'distances'; vertices: Float32Array; middle: Triple };

export type Reply = { number: number } & ({ result: Cloud | Float32Array } | { unreadable: string });

let cloud: Centred | null = null;
let nearest: Nearest | null = null;

async function read(file: Blob): Promise<Cloud> {
  cloud = nearest = null;
  const bytes = new Uint8Array(await file.arrayBuffer());
  const reading = readCloud(bytes);
  cloud = centred(reading);
  if (cloud.points.length === 0) throw new Unreadable('The file holds no points.');
  return thinned(cloud, reading.dialect);
}

function distances(vertices: Float32Array, middle: Triple): Float32Array {
  if (!cloud) throw new Unreadable('The input points are not here.');
  nearest ??= new Nearest(cloud.points);
  const [x, y, z] = middle.map((value, k) => value - (cloud as Centred).origin[k as 0 | 1 | 2]) as Triple;
  const found = new Float32Array(vertices.length / 3);
  for (let i = 0; i < found.length; i++) {
    found[i] = nearest.distance(
      (vertices[3 * i] as number) + x,
      (vertices[3 * i + 1] as number) + y,
      (vertices[3 * i + 2] as number) + z,
    );
  }
  return found;
}

self.onmessage = async ({ data }: MessageEvent<Request & { number: number }>) => {
  const answer = (reply: Reply, transfer: Transferable[] = []) => self.postMessage(reply, { transfer });
  try {
    if (data.task === 'read') {
      const result = await read(data.file);
      const colors = result.colors ? [result.colors.buffer] : [];
      answer({ number: data.number, result }, [result.positions.buffer, ...colors]);
    } else {
      const result = distances(data.vertices, data.middle);
      answer({ number: data.number, result }, [result.buffer]);
    }
  } catch (error) {
    const known = error instanceof Unreadable || error instanceof RangeError;
    answer({ number: data.number, unreadable: known ? error.message : String(error) });
  }
};
