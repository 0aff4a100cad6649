// Colours of figures: dark blue for little, yellow for much; told apart by eyes of every kind.

/** Viridis by nine anchors: grows in lightness, so that it also reads in grey. */
const VIRIDIS = ['#440154', '#472d7b', '#3b528b', '#2c728e', '#21918c', '#28ae80', '#5ec962', '#addc30', '#fde725'];

export const SCALE = VIRIDIS;

const rgb = VIRIDIS.map((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255));

/** sRGB → linear light, which the renderer mixes in. */
export function linear(value: number): number {
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}

/** Linear colours (n, 3) of values on the scale from 0 to `limit`. */
export function scaled(values: Float32Array, limit: number): Float32Array {
  const out = new Float32Array(3 * values.length);
  const last = VIRIDIS.length - 1;
  for (let i = 0; i < values.length; i++) {
    const at = Math.min(1, Math.max(0, (values[i] as number) / limit)) * last;
    const k = Math.min(last - 1, Math.floor(at));
    for (let c = 0; c < 3; c++) {
      const low = rgb[k]?.[c] ?? 0;
      out[3 * i + c] = linear(low + (at - k) * ((rgb[k + 1]?.[c] ?? 0) - low));
    }
  }
  return out;
}

/** Linear colours of 8-bit ones. */
export function linearBytes(colors: Uint8Array): Float32Array {
  const table = Float32Array.from({ length: 256 }, (_, k) => linear(k / 255));
  const out = new Float32Array(colors.length);
  for (let i = 0; i < colors.length; i++) out[i] = table[colors[i] as number] as number;
  return out;
}

/** The value that a share of the values is not above. */
export function quantile(values: Float32Array, share: number): number {
  const sorted = values.slice().sort();
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] ?? 0;
}
