// The eye: turns about the middle of what is shown, by mouse, fingers or keys.

import { PerspectiveCamera, Sphere, Spherical, Vector3 } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

export type Up = 'y' | 'z';

const STEP = Math.PI / 24;
const ZOOM = 1.15;

export class Eye {
  readonly camera = new PerspectiveCamera(40, 1, 0.01, 1000);
  private controls: OrbitControls;
  private sphere = new Sphere(new Vector3(), 1);
  private up: Up = 'z';
  private readonly canvas: HTMLCanvasElement;
  private readonly onMove: () => void;

  constructor(canvas: HTMLCanvasElement, onMove: () => void) {
    this.canvas = canvas;
    this.onMove = onMove;
    this.controls = this.made();
    canvas.addEventListener('keydown', (event) => this.key(event));
  }

  /** Look at all of it, from the side and a little above. */
  frame(sphere: Sphere): void {
    this.sphere = sphere.radius > 0 ? sphere : new Sphere(sphere.center, 1);
    const { center, radius } = this.sphere;
    const narrow = Math.min(1, this.camera.aspect);
    const away = (1.12 * radius) / Math.sin(Math.atan(Math.tan((this.camera.fov * Math.PI) / 360) * narrow));
    const from = this.up === 'z' ? new Vector3(0.55, -0.75, 0.45) : new Vector3(0.55, 0.45, 0.75);
    this.camera.position.copy(center).addScaledVector(from.normalize(), away);
    this.camera.near = away / 200;
    this.camera.far = away * 20;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(center);
    this.controls.update();
    this.onMove();
  }

  /** Which axis points up; the view begins anew. */
  setUp(up: Up): void {
    this.up = up;
    this.controls.dispose();
    this.controls = this.made(); // it takes the direction when it is made
    this.frame(this.sphere);
  }

  resize(width: number, height: number): void {
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  dispose(): void {
    this.controls.dispose();
  }

  private made(): OrbitControls {
    this.camera.up.set(0, this.up === 'y' ? 1 : 0, this.up === 'z' ? 1 : 0);
    const controls = new OrbitControls(this.camera, this.canvas);
    controls.addEventListener('change', this.onMove);
    return controls;
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const moves: Record<string, () => void> = {
      ArrowLeft: () => this.turn(-STEP, 0),
      ArrowRight: () => this.turn(STEP, 0),
      ArrowUp: () => this.turn(0, -STEP),
      ArrowDown: () => this.turn(0, STEP),
      '+': () => this.zoom(1 / ZOOM),
      '=': () => this.zoom(1 / ZOOM),
      '-': () => this.zoom(ZOOM),
      '0': () => this.frame(this.sphere),
    };
    const move = moves[event.key];
    if (!move) return;
    event.preventDefault();
    move();
  }

  private turn(around: number, over: number): void {
    // Spherical has y for its pole.
    const offset = this.camera.position.clone().sub(this.controls.target);
    const turned = this.up === 'z' ? new Vector3(offset.x, offset.z, -offset.y) : offset;
    const at = new Spherical().setFromVector3(turned);
    at.theta += around;
    at.phi = Math.min(Math.PI - 0.05, Math.max(0.05, at.phi + over));
    turned.setFromSpherical(at);
    if (this.up === 'z') offset.set(turned.x, -turned.z, turned.y);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.onMove();
  }

  private zoom(factor: number): void {
    const offset = this.camera.position.clone().sub(this.controls.target).multiplyScalar(factor);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.onMove();
  }
}
