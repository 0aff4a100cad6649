// The canvas, and the wires from what is to be shown to what draws it.

import { effect, useSignal } from '@preact/signals';
import type { ComponentChildren } from 'preact';
import { useEffect, useRef } from 'preact/hooks';

import { shown } from '../state/cloud.ts';
import { dark } from '../state/theme.ts';
import * as view from '../state/view.ts';
import type { Viewer } from '../view/viewer.ts';
import { Legend } from './Legend.tsx';

export function Stage({ children }: { children?: ComponentChildren }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const viewer = useRef<Viewer | null>(null);
  const failure = useSignal('');
  const words = useSignal('nothing yet');

  useEffect(() => {
    let stop = () => {};
    let gone = false;
    void (async () => {
      try {
        const { Viewer } = await import('../view/viewer.ts');
        if (gone || !canvas.current) return;
        viewer.current = new Viewer(canvas.current);
        stop = wire(viewer.current, (said) => (words.value = said));
      } catch {
        failure.value = 'This browser cannot draw in 3-D (it has no WebGL). Everything else works.';
      }
    })();
    return () => {
      gone = true;
      stop();
      viewer.current?.dispose();
      viewer.current = null;
    };
  }, []);

  return (
    <section class="stage" aria-label="View" data-meshes={view.meshes.value}>
      <canvas
        ref={canvas}
        tabIndex={0}
        role="application"
        aria-roledescription="3-D view"
        aria-label={`Shown: ${words.value}. Arrow keys turn it, plus and minus zoom, 0 shows all of it.`}
      />
      {failure.value && <p class="over">{failure.value}</p>}
      {children}
      <Legend />
      <div class="tools" role="group" aria-label="View">
        <button type="button" onClick={() => viewer.current?.frame()}>Show all</button>
        <button type="button" onClick={() => (view.up.value = view.up.value === 'z' ? 'y' : 'z')}>
          {view.up.value} is up
        </button>
      </div>
    </section>
  );
}

function wire(viewer: Viewer, say: (words: string) => void): () => void {
  const told = () => say(viewer.describe());
  const ends = [
    effect(() => viewer.setDark(dark.value)),
    effect(() => {
      viewer.setCloud(shown.value?.cloud ?? null);
      told();
    }),
    effect(() => {
      const glb = view.glb.value;
      viewer
        .setSurface(glb)
        .then((surface) => {
          view.surface.value = surface;
          if (surface) view.meshes.value++;
          told();
        })
        .catch(() => say('a mesh that cannot be drawn'));
    }),
    effect(() => {
      viewer.setLayers(view.layers.value);
      told();
    }),
    effect(() => {
      const paint = view.paint.value;
      viewer.paint(paint?.values ?? null, paint?.limit ?? 1);
    }),
    effect(() => viewer.setClip(view.clip.value)),
    effect(() => {
      const slice = view.slice.value;
      viewer.setSlice(slice?.slice ?? null, slice?.picture ?? null);
    }),
  ];
  let first = true;
  ends.push(
    effect(() => {
      const up = view.up.value;
      if (!first || up !== 'z') viewer.setUp(up);
      first = false;
    }),
  );
  return () => ends.forEach((end) => end());
}
