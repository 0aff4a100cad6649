// The names that tools give to columns; the service's list is mpf_core/cloud/columns.py.

export type Role = 'x' | 'y' | 'z' | 'nx' | 'ny' | 'nz' | 'red' | 'green' | 'blue';
export type Roles = Partial<Record<Role, number>>;

const surveyed = {
  x: ['easting', 'east'],
  y: ['northing', 'north'],
  z: ['elevation', 'height', 'altitude'],
};

/** Name → role and rank: where a file has several names of one role, the first one counts. */
const known = new Map<string, { role: Role; rank: number }>();

function learn(role: Role, names: string[]): void {
  names.forEach((name, rank) => known.set(name, { role, rank }));
}

for (const [number, axis] of (['x', 'y', 'z'] as const).entries()) {
  learn(axis, [
    axis, `${axis}_coord`, `${axis}coord`, `coord_${axis}`, `${axis}_coordinate`, `${axis}_pos`,
    `pos_${axis}`, `position_${axis}`, `position${axis}`, `points_${number}`, ...surveyed[axis],
  ]);
  learn(`n${axis}`, [
    `n${axis}`, `n_${axis}`, `${axis}n`, `normal_${axis}`, `normal${axis}`, `${axis}_normal`,
    `normals_${axis}`, `vertex_normal_${axis}`, `normals_${number}`, `normal_${number}`,
  ]);
}
for (const [number, color] of (['red', 'green', 'blue'] as const).entries()) {
  const letter = color[0] ?? '';
  learn(color, [
    color, letter, `diffuse_${color}`, `color_${color}`, `color_${letter}`, `vertex_${color}`,
    `${color}_color`, `${color}_value`, `${letter}f`, `rgb_${number}`, `rgba_${number}`,
    `colors_${number}`, `ambient_${color}`,
  ]);
}

/** Role → index into `names`. */
export function rolesOf(names: readonly string[]): Roles {
  const best = new Map<Role, { rank: number; index: number }>();
  names.forEach((name, index) => {
    const found = known.get(plainName(name));
    if (found && found.rank < (best.get(found.role)?.rank ?? Infinity)) {
      best.set(found.role, { rank: found.rank, index });
    }
  });
  return Object.fromEntries([...best].map(([role, { index }]) => [role, index])) as Roles;
}

function plainName(name: string): string {
  return name
    .trim()
    .toLowerCase()
    .replace(/["'`]/g, '')
    .replace(/\s*[([](m|mm|cm|km|ft|in|meters?|metres?)[)\]]$/, '')
    .replace(/^[/#% ]+/, '')
    .replace(/[\s:.\-[\]]+/g, '_')
    .replace(/^_+|_+$/g, '');
}

export function hasAll(roles: Roles, wanted: readonly Role[]): boolean {
  return wanted.every((role) => roles[role] !== undefined);
}
