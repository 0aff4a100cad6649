// Where a cloud comes in: dropped, chosen, or one of the samples.

import { useSignal } from '@preact/signals';
import type { ComponentChildren } from 'preact';

import { SAMPLES, sampleFile, type Sample } from '../cloud/samples.ts';
import { choose } from '../state/cloud.ts';
import { count } from '../state/format.ts';
import { unit } from '../state/unit.ts';

/** Takes files that are dropped anywhere on it. */
export function DropZone({ children, disabled }: { children: ComponentChildren; disabled: boolean }) {
  const over = useSignal(false);
  const take = (event: DragEvent) => {
    event.preventDefault();
    over.value = false;
    const file = event.dataTransfer?.files[0];
    if (file && !disabled) void choose(file);
  };
  return (
    <main
      class={`work ${over.value && !disabled ? 'over-drop' : ''}`}
      onDragOver={(event) => {
        event.preventDefault();
        over.value = true;
      }}
      onDragLeave={() => (over.value = false)}
      onDrop={take}
    >
      {children}
    </main>
  );
}

export function Chooser({ disabled }: { disabled: boolean }) {
  const pick = (event: Event) => {
    const field = event.currentTarget as HTMLInputElement;
    const file = field.files?.[0];
    if (file) void choose(file);
    field.value = ''; // so that the same file can be chosen again
  };
  return (
    <div class="chooser">
      <label class="button main">
        Choose a point cloud
        <input type="file" class="hidden" accept=".ply,.xyz,.txt,.csv,.pts,.asc,.pwn" disabled={disabled} onChange={pick} />
      </label>
      <p>or drop one anywhere here: PLY, or rows of numbers. No normals needed.</p>
      <div class="samples" role="group" aria-label="Sample clouds">
        <span>Samples:</span>
        {SAMPLES.map((sample) => (
          <button key={sample.name} type="button" disabled={disabled} onClick={() => void take(sample)}>
            {sample.name} <small>{sample.about}, {count(sample.points)} points</small>
          </button>
        ))}
      </div>
    </div>
  );
}

function take(sample: Sample): Promise<void> {
  unit.value = 'm';
  return choose(new File([sampleFile(sample)], `${sample.name}.ply`));
}
