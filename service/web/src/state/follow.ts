// One job, followed until it has ended: by events, and by long polls where those do not come through.

import { signal } from '@preact/signals';

import { ENDED, file, show, type Job, type Progress } from '../api/client.ts';
import { readEvents, type JobEvent } from '../api/events.ts';
import { problemOf, Refusal, type Problem } from '../api/problem.ts';
import { extended, forget, keep, recall, type Point } from './history.ts';

/** A report of progress; of a job in tiles, how far those are. */
type Told = Progress & { tiles?: Job['tiles'] };

export type Link = 'connecting' | 'live' | 'polling' | 'lost' | 'done';

const PATIENCE = 2; // streams that break at once before long polls take over
const POLL_SECONDS = 25;
const QUEUE_SECONDS = 3;
const LONGEST_PAUSE = 10;

export class Follower {
  readonly job = signal<Job | null>(null);
  readonly history = signal<Point[]>([]);
  /** The latest mesh of the unfinished fit, and its number. */
  readonly preview = signal<{ glb: ArrayBuffer; number: number } | null>(null);
  readonly link = signal<Link>('connecting');
  /** Why there is nothing to follow. */
  readonly problem = signal<Problem | null>(null);

  private readonly stopping = new AbortController();
  private last = '';
  private wake = () => {};
  private previews = 0;

  private readonly id: string;

  constructor(id: string) {
    this.id = id;
    const known = recall(id);
    this.history.value = known.points;
    this.last = known.last;
  }

  start(): void {
    const awake = () => document.visibilityState === 'visible' && this.wake();
    addEventListener('online', this.awaken, { signal: this.stopping.signal });
    document.addEventListener('visibilitychange', awake, { signal: this.stopping.signal });
    void this.follow();
    void this.watchQueue();
  }

  stop(): void {
    this.stopping.abort();
    this.wake();
  }

  /** Look at the record now. */
  async refresh(): Promise<void> {
    this.take(await show(this.id));
  }

  private readonly awaken = () => this.wake();

  private get over(): boolean {
    return this.stopping.signal.aborted || ENDED.has(this.job.value?.state ?? '');
  }

  private async follow(): Promise<void> {
    let broken = 0;
    while (!this.over) {
      try {
        await this.refresh();
        if (this.over) break;
        if (broken > PATIENCE) await this.poll();
        else await this.stream();
        broken = 0;
      } catch (error) {
        if (this.stopping.signal.aborted) return;
        if (error instanceof Refusal && !error.passing && error.problem.status < 500) {
          this.problem.value = problemOf(error);
          return;
        }
        broken++;
        this.link.value = broken > PATIENCE ? 'polling' : 'lost';
        if (error instanceof Refusal) this.link.value = 'lost';
        await this.pause(Math.min(LONGEST_PAUSE, 0.5 * 2 ** Math.min(broken, 5)));
      }
    }
    if (!this.stopping.signal.aborted) this.link.value = 'done';
  }

  private async stream(): Promise<void> {
    await readEvents(this.id, this.last, (event) => this.hear(event), this.stopping.signal);
    if (!this.over) await this.refresh();
  }

  private async poll(): Promise<void> {
    this.link.value = 'polling';
    this.take(await show(this.id, POLL_SECONDS, this.stopping.signal));
  }

  private hear({ id, name, data }: JobEvent): void {
    this.link.value = 'live';
    this.last = id || this.last;
    if (name === 'job') this.take(data as Job);
    else if (name === 'progress') this.progress(data as Told);
    else if (name === 'preview') void this.fetchPreview((data as { number: number }).number);
    else if (name === 'state') void this.refresh().catch(() => {});
    keep(this.id, { points: this.history.value, last: this.last });
  }

  private progress(progress: Told): void {
    const job = this.job.value;
    if (!job || ENDED.has(job.state)) return;
    this.history.value = extended(this.history.value, progress, job.attempt);
    const tiles = progress.tiles ?? job.tiles;
    this.job.value = { ...job, state: 'running', queue_position: null, progress, tiles };
  }

  private take(job: Job): void {
    if (this.stopping.signal.aborted) return;
    // A snapshot of the stream does not tell the place in the queue; the record does.
    const place = job.queue_position ?? (job.state === 'queued' ? this.job.value?.queue_position : null);
    this.job.value = { ...job, queue_position: place ?? null };
    if (job.progress) this.history.value = extended(this.history.value, job.progress, job.attempt);
    if (job.links['preview'] && !this.preview.value) void this.fetchPreview(0);
    if (ENDED.has(job.state)) forget(this.id);
  }

  private async fetchPreview(number: number): Promise<void> {
    const mine = ++this.previews;
    try {
      const response = await file(`/jobs/${this.id}/preview.glb`, this.stopping.signal);
      const glb = await response.arrayBuffer();
      if (mine === this.previews) this.preview.value = { glb, number };
    } catch {
      // The next one comes in a few seconds, or the result.
    }
  }

  /** Places in the queue are not events. */
  private async watchQueue(): Promise<void> {
    while (!this.over) {
      await this.pause(QUEUE_SECONDS);
      if (this.job.value?.state === 'queued') await this.refresh().catch(() => {});
    }
  }

  private pause(seconds: number): Promise<void> {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, seconds * 1000);
      this.wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}
