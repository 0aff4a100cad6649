// A job's server-sent events, read by fetch so that the key travels in a header.

import { createParser } from 'eventsource-parser';

import { request } from './client.ts';
import { refusalOf } from './problem.ts';

export interface JobEvent {
  id: string;
  name: string;
  data: unknown;
}

/** The service says something every 15 s: a connection silent for longer than this is dead. */
const SILENCE_SECONDS = 40;

/** Hand on the events behind `last` until the service ends the stream; rejects when it breaks. */
export async function readEvents(
  id: string, last: string, onEvent: (event: JobEvent) => void, signal: AbortSignal,
): Promise<void> {
  const own = new AbortController();
  const stop = AbortSignal.any([signal, own.signal]);
  const headers: Record<string, string> = { Accept: 'text/event-stream' };
  if (last) headers['Last-Event-ID'] = last;
  const response = await request(`/jobs/${id}/events`, { headers, signal: stop });
  if (!response.ok) throw await refusalOf(response);
  const parser = createParser({
    onEvent: ({ id: eventId, event, data }) =>
      onEvent({ id: eventId ?? '', name: event ?? 'message', data: JSON.parse(data) }),
  });
  const reader = (response.body as ReadableStream<Uint8Array>).getReader();
  const decoder = new TextDecoder();
  for (;;) {
    const timer = setTimeout(() => own.abort(), SILENCE_SECONDS * 1000);
    const { done, value } = await reader.read().finally(() => clearTimeout(timer));
    if (done) return;
    parser.feed(decoder.decode(value, { stream: true }));
  }
}
