// A picture of the field on the plane that it was taken on.

import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshBasicMaterial, SRGBColorSpace, Texture } from 'three';

import type { Triple } from '../cloud/cloud.ts';
import { AXES, type Axis, type Slice } from './axes.ts';

/** The axes to the right and up in a picture across each axis (mpf_core/surface/sliceimage.py). */
const ACROSS: Record<Axis, [number, number]> = { x: [1, 2], y: [0, 2], z: [0, 1] };

/** A slice of which is known where it lies. */
export type Placed = Required<Slice>;

export class SlicePlane {
  readonly mesh: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly texture: Texture;

  constructor(slice: Placed, picture: ImageBitmap, origin: Triple) {
    // Bitmaps begin at the top; so do the texture's rows, which are not turned over.
    this.texture = new Texture(picture);
    this.texture.flipY = false;
    this.texture.colorSpace = SRGBColorSpace;
    this.texture.needsUpdate = true;
    const material = new MeshBasicMaterial({ map: this.texture, side: DoubleSide, transparent: true, opacity: 0.92 });
    this.mesh = new Mesh(quad(slice, picture, origin), material);
  }

  dispose(): void {
    this.mesh.removeFromParent();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.texture.dispose();
    (this.texture.image as ImageBitmap).close();
  }
}

function quad(slice: Placed, picture: ImageBitmap, origin: Triple): BufferGeometry {
  const [left, right, bottom, top] = slice.extent;
  const [x, y, width, height] = slice.plot;
  const across = ACROSS[slice.axis];
  const positions: number[] = [];
  for (const [a, b] of [[left, bottom], [right, bottom], [right, top], [left, top]] as const) {
    const corner: Triple = [0, 0, 0];
    corner[AXES.indexOf(slice.axis) as 0 | 1 | 2] = slice.at;
    corner[across[0] as 0 | 1 | 2] = a;
    corner[across[1] as 0 | 1 | 2] = b;
    positions.push(...corner.map((value, k) => value - (origin[k] as number)));
  }
  const [u0, u1] = [x / picture.width, (x + width) / picture.width];
  const [v0, v1] = [y / picture.height, (y + height) / picture.height];
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(new Float32Array(positions), 3));
  geometry.setAttribute('uv', new BufferAttribute(new Float32Array([u0, v1, u1, v1, u1, v0, u0, v0]), 2));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  return geometry;
}
