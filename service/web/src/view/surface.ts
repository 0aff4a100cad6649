// A mesh from GLB, as the view draws it: its material is ours, so that layers can change it.

import {
  BufferAttribute, DoubleSide, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial,
  WireframeGeometry, type BufferGeometry, type Plane,
} from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

import type { Triple } from '../cloud/cloud.ts';
import { scaled } from './colors.ts';

const loader = new GLTFLoader();
/** Lines for more triangles than this are a blot, and take long to make. */
export const WIRED_MOST = 600_000;

export class Surface {
  readonly mesh: Mesh<BufferGeometry, MeshStandardMaterial>;
  /** What the vertices are relative to, in double precision. */
  readonly middle: Triple;
  readonly triangles: number;
  private lines: LineSegments | null = null;
  private readonly painted: BufferAttribute | null;
  private readonly clipping: Plane[];

  private constructor(geometry: BufferGeometry, middle: Triple, clipping: Plane[]) {
    this.middle = middle;
    this.clipping = clipping;
    this.triangles = (geometry.index?.count ?? 0) / 3;
    this.painted = (geometry.getAttribute('color') as BufferAttribute | undefined) ?? null;
    if (!geometry.getAttribute('normal')) geometry.computeVertexNormals();
    const material = new MeshStandardMaterial({
      roughness: 0.8, metalness: 0, side: DoubleSide, clippingPlanes: clipping,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
    });
    this.mesh = new Mesh(geometry, material);
    this.paint(null, 1);
  }

  /** Rejects if this is no GLB with a mesh. */
  static async from(glb: ArrayBuffer, clipping: Plane[]): Promise<Surface> {
    const { scene } = await loader.parseAsync(glb, '');
    let found: Mesh | null = null;
    scene.traverse((node) => {
      if (!found && (node as Mesh).isMesh) found = node as Mesh;
    });
    if (!found) throw new Error('The GLB holds no mesh.');
    const { geometry, position } = found as Mesh;
    return new Surface(geometry, position.toArray() as Triple, clipping);
  }

  get vertices(): Float32Array {
    return this.mesh.geometry.getAttribute('position').array as Float32Array;
  }

  /** Colours by a value per vertex, on a scale from 0 to `limit`; null: the mesh's own. */
  paint(values: Float32Array | null, limit: number): void {
    const { geometry, material } = this.mesh;
    const colors = values ? new BufferAttribute(scaled(values, limit), 3) : this.painted;
    if (colors) geometry.setAttribute('color', colors);
    else geometry.deleteAttribute('color');
    material.vertexColors = colors !== null;
    material.color.set(colors ? 0xffffff : 0xb4bcc4);
    material.needsUpdate = true;
  }

  /** The edges of the triangles, made when first asked for; null where there are too many. */
  get wireframe(): LineSegments | null {
    if (!this.lines && this.triangles <= WIRED_MOST) {
      const material = new LineBasicMaterial({
        color: 0x10181f, transparent: true, opacity: 0.35, clippingPlanes: this.clipping,
      });
      this.lines = new LineSegments(new WireframeGeometry(this.mesh.geometry), material);
      this.mesh.add(this.lines);
    }
    return this.lines;
  }

  dispose(): void {
    this.mesh.removeFromParent();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    if (this.lines) {
      this.lines.geometry.dispose();
      (this.lines.material as LineBasicMaterial).dispose();
    }
  }
}
