// The 3-D view: points, surface, slice, clipping plane. It draws when something changed, not all the
// time: a page that only waits uses no processor.

import {
  Box3, BufferAttribute, BufferGeometry, DirectionalLight, HemisphereLight, Plane, Points,
  PointsMaterial, Scene, Sphere, Vector3, WebGLRenderer,
} from 'three';

import type { Cloud, Triple } from '../cloud/cloud.ts';
import { AXES, type Axis } from './axes.ts';
import { Eye, type Up } from './camera.ts';
import { linearBytes } from './colors.ts';
import { SlicePlane, type Placed } from './slice.ts';
import { Surface } from './surface.ts';

export interface Layers {
  points: boolean;
  surface: boolean;
  wireframe: boolean;
}

export interface Cut {
  axis: Axis;
  /** In the input's units. */
  at: number;
}

export class Viewer {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly eye: Eye;
  private readonly resizing: ResizeObserver;
  private readonly clip = new Plane();
  private readonly clipping: Plane[] = [];
  private points: Points<BufferGeometry, PointsMaterial> | null = null;
  private surface: Surface | null = null;
  private slice: SlicePlane | null = null;
  private origin: Triple | null = null;
  private layers: Layers = { points: true, surface: true, wireframe: false };
  private framed = false;
  private asked = 0;
  private rounds = 0;
  private pointColor = 0x35566b;

  /** Throws where the browser has no WebGL. */
  constructor(canvas: HTMLCanvasElement) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.eye = new Eye(canvas, () => this.draw());
    const head = new DirectionalLight(0xffffff, 2.1);
    head.position.set(-0.4, 0.6, 1);
    this.eye.camera.add(head);
    this.scene.add(this.eye.camera, new HemisphereLight(0xffffff, 0x8a8f99, 1.1));
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(canvas.parentElement ?? canvas);
    this.resize();
  }

  setCloud(cloud: Cloud | null): void {
    this.points?.removeFromParent();
    this.points?.geometry.dispose();
    this.points?.material.dispose();
    this.points = null;
    this.origin = cloud?.origin ?? null;
    this.framed = false;
    if (cloud) {
      const geometry = new BufferGeometry();
      geometry.setAttribute('position', new BufferAttribute(cloud.positions, 3));
      if (cloud.colors) geometry.setAttribute('color', new BufferAttribute(linearBytes(cloud.colors), 3));
      const material = new PointsMaterial({
        size: cloud.shown > 100_000 ? 1.5 : 2.5, sizeAttenuation: false,
        vertexColors: cloud.colors !== null, clippingPlanes: this.clipping,
      });
      if (!cloud.colors) material.color.set(this.pointColor);
      this.points = new Points(geometry, material);
      this.scene.add(this.points);
    }
    this.place();
    this.arrange();
  }

  /** Show a mesh; null takes it away. Of several asked for at a time the last one stays. */
  async setSurface(glb: ArrayBuffer | null): Promise<Surface | null> {
    const mine = ++this.rounds;
    const fresh = glb && (await Surface.from(glb, this.clipping));
    if (mine !== this.rounds) {
      fresh?.dispose();
      return this.surface;
    }
    this.surface?.dispose();
    this.surface = fresh;
    if (fresh) this.scene.add(fresh.mesh);
    this.place();
    this.arrange();
    return fresh;
  }

  setLayers(layers: Layers): void {
    this.layers = layers;
    this.arrange();
  }

  /** Colour the surface by a value per vertex on a scale up to `limit`; null: as it is. */
  paint(values: Float32Array | null, limit: number): void {
    this.surface?.paint(values, limit);
    this.draw();
  }

  /** Take away what lies beyond the plane on the side of the greater coordinates. */
  setClip(cut: Cut | null): void {
    this.clipping.length = 0;
    if (cut) {
      const k = AXES.indexOf(cut.axis) as 0 | 1 | 2;
      this.clip.normal.set(0, 0, 0).setComponent(k, -1);
      this.clip.constant = cut.at - (this.middle()[k] as number);
      this.clipping.push(this.clip);
    }
    this.draw();
  }

  setSlice(slice: Placed | null, picture: ImageBitmap | null): void {
    this.slice?.dispose();
    this.slice = slice && picture ? new SlicePlane(slice, picture, this.middle()) : null;
    if (this.slice) this.scene.add(this.slice.mesh);
    this.draw();
  }

  setUp(up: Up): void {
    this.eye.setUp(up);
  }

  setDark(dark: boolean): void {
    this.pointColor = dark ? 0x9cc3d8 : 0x2f5268;
    if (this.points && !this.points.material.vertexColors) this.points.material.color.set(this.pointColor);
    this.draw();
  }

  /** Look at all of it. */
  frame(): void {
    const box = new Box3();
    for (const part of [this.points, this.surface?.mesh]) if (part) box.expandByObject(part);
    if (!box.isEmpty()) this.eye.frame(box.getBoundingSphere(new Sphere()));
  }

  /** In words, for those who do not see it. */
  describe(): string {
    const parts: string[] = [];
    const points = this.points?.geometry.getAttribute('position').count ?? 0;
    if (points && this.layers.points) parts.push(`${points.toLocaleString('en')} points`);
    if (this.surface && (this.layers.surface || this.layers.wireframe)) {
      parts.push(`a surface of ${this.surface.triangles.toLocaleString('en')} triangles`);
    }
    return parts.join(' and ') || 'nothing yet';
  }

  dispose(): void {
    cancelAnimationFrame(this.asked);
    this.resizing.disconnect();
    this.eye.dispose();
    this.setSlice(null, null);
    this.surface?.dispose();
    this.points?.geometry.dispose();
    this.points?.material.dispose();
    this.renderer.dispose();
  }

  /** What coordinates in the view are relative to: large ones would lose their digits there. */
  private middle(): Triple {
    return this.origin ?? this.surface?.middle ?? [0, 0, 0];
  }

  private place(): void {
    const middle = this.middle();
    if (this.surface) {
      const offset = this.surface.middle.map((value, k) => value - (middle[k] as number)) as Triple;
      this.surface.mesh.position.copy(new Vector3(...offset));
    }
    if (!this.framed && (this.points || this.surface)) {
      this.frame();
      this.framed = true;
    }
  }

  private arrange(): void {
    const { points, surface, wireframe } = this.layers;
    if (this.points) this.points.visible = points;
    if (this.surface) {
      this.surface.mesh.visible = surface || wireframe;
      this.surface.mesh.material.visible = surface;
      const lines = wireframe ? this.surface.wireframe : null;
      for (const child of this.surface.mesh.children) child.visible = child === lines;
    }
    this.draw();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.renderer.domElement.parentElement ?? this.renderer.domElement;
    if (!clientWidth || !clientHeight) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.eye.resize(clientWidth, clientHeight);
    this.draw();
  }

  private draw(): void {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = 0;
      this.renderer.render(this.scene, this.eye.camera);
      this.renderer.domElement.dataset['shows'] = this.describe();
    });
  }
}
