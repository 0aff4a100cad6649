// A cloud, its options, and off it goes.

import { useSignal, type Signal } from '@preact/signals';
import { useEffect } from 'preact/hooks';

import { submit, type Capabilities, type Options } from '../api/client.ts';
import { problemOf, type Problem } from '../api/problem.ts';
import { send, type Sending } from '../api/upload.ts';
import { CloudFacts } from '../parts/CloudFacts.tsx';
import { Chooser, DropZone } from '../parts/DropZone.tsx';
import { Notice } from '../parts/Notice.tsx';
import { OptionsForm } from '../parts/OptionsForm.tsx';
import { Stage } from '../parts/Stage.tsx';
import { belongsTo, drop, shown } from '../state/cloud.ts';
import { bytes, count, seconds } from '../state/format.ts';
import { go } from '../state/route.ts';
import { changed } from '../state/schema.ts';
import { askService, refused, service } from '../state/service.ts';
import { clear } from '../state/view.ts';

interface Upload {
  sending: Sending | null;
  sent: number;
  all: number;
  /** In words. */
  stage: string;
}

export function NewPage() {
  const values = useSignal<Options>({ preset: 'draft' });
  const upload = useSignal<Upload | null>(null);
  const problem = useSignal<Problem | null>(null);
  useEffect(() => {
    clear();
    if (!shown.value?.file) drop();
  }, []);
  useEffect(() => shown.subscribe((now) => now && !upload.value && (problem.value = null)), []);
  const file = shown.value?.file ?? null;
  const offer = service.value;
  const objection = file && offer ? objectionTo(file, offer) : '';
  const start = async (event: SubmitEvent) => {
    event.preventDefault();
    if (file && offer) await reconstruct(file, offer, values.value, upload, problem);
  };
  return (
    <DropZone disabled={upload.value !== null}>
      <Stage>{!file && <p class="over">Drop a point cloud here</p>}</Stage>
      <form class="panel" onSubmit={start}>
        <h1>From points to a surface</h1>
        <Chooser disabled={upload.value !== null} />
        {offer && <LimitsTold offer={offer} />}
        {refused.value && refused.value.code !== 'access.denied' && <Notice problem={refused.value} again={askService} />}
        <CloudFacts />
        {problem.value && <Notice problem={problem.value} />}
        {objection && <p class="note" role="alert">{objection}</p>}
        {offer && file && <OptionsForm service={offer} values={values} />}
        {file && offer && !upload.value && (
          <button class="main wide" type="submit" disabled={objection !== ''}>Reconstruct the surface</button>
        )}
        {upload.value && <Progress upload={upload.value} />}
      </form>
    </DropZone>
  );
}

function LimitsTold({ offer }: { offer: Capabilities }) {
  const { limits } = offer;
  return (
    <p class="limits">
      Up to {bytes(limits.input_bytes)} and {count(limits.points_most)} points, at least {limits.points_least}.
      Results are kept for {seconds(limits.retention_seconds)}.
    </p>
  );
}

/** Why the service would refuse the file, as far as that is known here. */
function objectionTo(file: File, { limits }: Capabilities): string {
  if (file.size > limits.input_bytes) {
    return `The file has ${bytes(file.size)}; this service takes ${bytes(limits.input_bytes)}. Thin the cloud first.`;
  }
  const points = shown.value?.cloud?.count;
  if (points !== undefined && points > limits.points_most) {
    return `The cloud has ${count(points)} points; this service takes ${count(limits.points_most)}. Thin it first.`;
  }
  if (points !== undefined && points < limits.points_least) {
    return `The cloud has ${count(points)} points; a surface needs at least ${limits.points_least}.`;
  }
  return '';
}

async function reconstruct(
  file: File, offer: Capabilities, values: Options, upload: Signal<Upload | null>, problem: Signal<Problem | null>,
): Promise<void> {
  problem.value = null;
  const tell = (change: Partial<Upload>) => upload.value && (upload.value = { ...upload.value, ...change });
  upload.value = { sending: null, sent: 0, all: file.size, stage: 'Uploading' };
  const sending = send(
    file, offer.uploads.href,
    (sent) => tell({ sent, stage: 'Uploading' }),
    () => tell({ stage: 'The connection was lost; going on when it is back' }),
  );
  tell({ sending });
  try {
    const href = await sending.done;
    tell({ stage: 'Checking the points', sent: file.size, sending: null });
    const preset = String(values['preset'] ?? 'balanced');
    const options = { ...changed(values, offer.presets[preset] ?? {}), preset };
    const job = await submit(href, options, crypto.randomUUID());
    belongsTo(job.id);
    go(`#/jobs/${job.id}`);
  } catch (error) {
    upload.value = null;
    if (!(error instanceof DOMException && error.name === 'AbortError')) problem.value = problemOf(error);
  }
}

function Progress({ upload }: { upload: Upload }) {
  const { sent, all, stage, sending } = upload;
  return (
    <section class="progress" aria-label="Upload" aria-live="polite">
      <p>{stage} … {bytes(sent)} of {bytes(all)}</p>
      <progress max={all || 1} value={sent} aria-label="Uploaded" />
      {sending && <button type="button" onClick={sending.abort}>Stop the upload</button>}
    </section>
  );
}
