// Requests to the service, typed by its OpenAPI document.

import createClient from 'openapi-fetch';

import { authorization } from './access.ts';
import { refusalOf, unanswered } from './problem.ts';
import type { components, paths } from './schema.d.ts';

export type Job = components['schemas']['Job'];
export type JobList = components['schemas']['JobList'];
export type Progress = components['schemas']['Progress'];
export type Artifact = components['schemas']['Artifact'];
export type Capabilities = components['schemas']['Capabilities'];
export type Share = components['schemas']['Share'];
export type Options = Record<string, unknown>;

/** fetch with the key; rejects with Refusal where nothing answers. */
export async function request(input: RequestInfo | URL, init: RequestInit = {}): Promise<Response> {
  const headers = new Headers(init.headers ?? (input instanceof Request ? input.headers : undefined));
  for (const [name, value] of Object.entries(authorization())) headers.set(name, value);
  try {
    return await fetch(input, { ...init, headers });
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error;
    throw unanswered();
  }
}

const api = createClient<paths>({ baseUrl: location.origin, fetch: (input) => request(input) });

async function ok<T>(call: Promise<{ data?: T; error?: unknown; response: Response }>): Promise<T> {
  const { data, response, error } = await call;
  if (response.ok) return data as T;
  throw await refusalOf(new Response(JSON.stringify(error), { status: response.status }));
}

const at = (job_id: string) => ({ path: { job_id } });

export const capabilities = () => ok(api.GET('/capabilities'));

export const show = (id: string, wait = 0, signal?: AbortSignal) =>
  ok(api.GET('/jobs/{job_id}', { params: { ...at(id), query: { wait } }, ...(signal && { signal }) }));

export const list = (query: { cursor?: string; label?: string; limit?: number }) =>
  ok(api.GET('/jobs', { params: { query } }));

export const remove = (id: string) => ok(api.DELETE('/jobs/{job_id}', { params: at(id) }));

export const cancel = (id: string, keep: boolean) =>
  ok(api.POST('/jobs/{job_id}/cancel', { params: { ...at(id), query: keep ? { keep: 'result' } : {} } }));

export const retry = (id: string, options: Options = {}) =>
  ok(api.POST('/jobs/{job_id}/retry', { params: at(id), body: { options, label: '' } }));

export const extract = (id: string, options: Options, label = '') =>
  ok(api.POST('/jobs/{job_id}/extractions', { params: at(id), body: { options, label } }));

export const submit = (upload: string, options: Options, key: string) =>
  ok(api.POST('/jobs', { params: { header: { 'idempotency-key': key } }, body: { upload, options } }));

export const share = (id: string, seconds: number) =>
  ok(api.POST('/jobs/{job_id}/shares', { params: at(id), body: { seconds } }));

export const unshare = (id: string, share_id: string) =>
  ok(api.DELETE('/jobs/{job_id}/shares/{share_id}', { params: { path: { job_id: id, share_id } } }));

export const shared = (token: string) => ok(api.GET('/shared/{token}', { params: { path: { token } } }));

/** A file of a job; rejects with Refusal. */
export async function file(href: string, signal?: AbortSignal): Promise<Response> {
  const response = await request(href, signal ? { signal } : {});
  if (!response.ok) throw await refusalOf(response);
  return response;
}

export const ENDED = new Set<string>(['succeeded', 'failed', 'cancelled', 'expired']);
