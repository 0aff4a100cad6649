// Axes and slices, apart from what draws them.

export type Axis = 'x' | 'y' | 'z';
export const AXES: Axis[] = ['x', 'y', 'z'];

/** One slice as the report tells of it. */
export interface Slice {
  file: string;
  field: string;
  axis: Axis;
  /** Along the axis, in the input's units. */
  at: number;
  /** Of the plot: left, right, bottom, top in the input's units. */
  extent?: [number, number, number, number];
  /** Where the plot lies in the picture: left, top, width, height in pixels. */
  plot?: [number, number, number, number];
}
