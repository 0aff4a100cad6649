// What the 3-D view shows. Pages set it, the stage draws it.

import { signal } from '@preact/signals';

import type { Up } from '../view/camera.ts';
import type { Placed } from '../view/slice.ts';
import type { Surface } from '../view/surface.ts';
import type { Cut, Layers } from '../view/viewer.ts';

export const layers = signal<Layers>({ points: true, surface: true, wireframe: false });
export const up = signal<Up>('z');
/** The mesh to be shown, as GLB. */
export const glb = signal<ArrayBuffer | null>(null);
/** The mesh that is shown. */
export const surface = signal<Surface | null>(null);
/** How many meshes have been shown since the view was cleared. */
export const meshes = signal(0);
export const paint = signal<{ values: Float32Array; limit: number } | null>(null);
export const clip = signal<Cut | null>(null);
export const slice = signal<{ slice: Placed; picture: ImageBitmap } | null>(null);

/** Nothing but the points. */
export function clear(): void {
  layers.value = { points: true, surface: true, wireframe: false };
  glb.value = null;
  meshes.value = 0;
  paint.value = null;
  clip.value = null;
  slice.value = null;
}
