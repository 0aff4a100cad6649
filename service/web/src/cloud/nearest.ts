// Distances to the nearest of many points: cells of a grid, sorted by counting.

export class Nearest {
  private readonly points: Float32Array;
  private readonly cell: number;
  private readonly low: [number, number, number];
  private readonly size: [number, number, number];
  private readonly begin: Uint32Array;
  private readonly order: Uint32Array;

  /** points: (n, 3), n > 0. */
  constructor(points: Float32Array) {
    this.points = points;
    const { low, extent } = boxOf(points);
    this.low = low;
    const count = points.length / 3;
    const longest = Math.max(...extent, 1e-30);
    // Points lie on surfaces: about two in each cell that a surface crosses.
    const across = Math.min(160, Math.max(1, Math.round(Math.sqrt(count / 2))));
    this.cell = longest / across;
    this.size = extent.map((e) => Math.min(across, Math.floor(e / this.cell)) + 1) as [number, number, number];
    this.begin = new Uint32Array(this.size[0] * this.size[1] * this.size[2] + 1);
    this.order = new Uint32Array(count);
    this.sort(count);
  }

  /** Distance of (x, y, z) to the nearest point. */
  distance(x: number, y: number, z: number): number {
    const at = [this.index(x, 0), this.index(y, 1), this.index(z, 2)] as const;
    let best = Infinity;
    const furthest = Math.max(...this.size);
    for (let ring = 0; ring <= furthest; ring++) {
      best = Math.min(best, this.inRing(x, y, z, at, ring));
      // What lies beyond this ring is further away than its edge.
      if (best <= this.reach(x, y, z, at, ring) ** 2) break;
    }
    return Math.sqrt(best);
  }

  private reach(x: number, y: number, z: number, at: readonly number[], ring: number): number {
    let least = Infinity;
    for (const [k, value] of [x, y, z].entries()) {
      const local = value - (this.low[k] as number);
      const index = at[k] as number;
      if (index - ring > 0) least = Math.min(least, local - (index - ring) * this.cell);
      if (index + ring + 1 < (this.size[k] as number)) {
        least = Math.min(least, (index + ring + 1) * this.cell - local);
      }
    }
    return Math.max(0, least);
  }

  private inRing(x: number, y: number, z: number, at: readonly number[], ring: number): number {
    const [nx, ny, nz] = this.size;
    const [ix, iy, iz] = at as [number, number, number];
    let best = Infinity;
    for (let k = Math.max(0, iz - ring); k <= Math.min(nz - 1, iz + ring); k++) {
      const edge = Math.abs(k - iz) === ring;
      for (let j = Math.max(0, iy - ring); j <= Math.min(ny - 1, iy + ring); j++) {
        const whole = edge || Math.abs(j - iy) === ring;
        const step = whole || ring === 0 ? 1 : 2 * ring;
        for (let i = ix - ring; i <= ix + ring; i += step) {
          if (i >= 0 && i < nx) best = Math.min(best, this.inCell(x, y, z, i + nx * (j + ny * k)));
        }
      }
    }
    return best;
  }

  private inCell(x: number, y: number, z: number, cell: number): number {
    const { points, order, begin } = this;
    let best = Infinity;
    for (let i = begin[cell] as number; i < (begin[cell + 1] as number); i++) {
      const at = 3 * (order[i] as number);
      const dx = (points[at] as number) - x;
      const dy = (points[at + 1] as number) - y;
      const dz = (points[at + 2] as number) - z;
      const square = dx * dx + dy * dy + dz * dz;
      if (square < best) best = square;
    }
    return best;
  }

  private index(value: number, k: 0 | 1 | 2): number {
    return Math.min(this.size[k] - 1, Math.max(0, Math.floor((value - this.low[k]) / this.cell)));
  }

  private sort(count: number): void {
    const { points, begin, order, size } = this;
    const cells = new Uint32Array(count);
    for (let i = 0; i < count; i++) {
      const cell =
        this.index(points[3 * i] as number, 0) +
        size[0] * (this.index(points[3 * i + 1] as number, 1) + size[1] * this.index(points[3 * i + 2] as number, 2));
      cells[i] = cell;
      begin[cell + 1] = (begin[cell + 1] as number) + 1;
    }
    for (let cell = 1; cell < begin.length; cell++) {
      begin[cell] = (begin[cell] as number) + (begin[cell - 1] as number);
    }
    const next = begin.slice();
    for (let i = 0; i < count; i++) {
      const cell = cells[i] as number;
      order[next[cell] as number] = i;
      next[cell] = (next[cell] as number) + 1;
    }
  }
}

function boxOf(points: Float32Array): { low: [number, number, number]; extent: number[] } {
  const low: [number, number, number] = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let at = 0; at < points.length; at++) {
    const k = at % 3;
    const value = points[at] as number;
    if (value < (low[k] as number)) low[k] = value;
    if (value > (high[k] as number)) high[k] = value;
  }
  return { low, extent: high.map((value, k) => value - (low[k] as number)) };
}
