// What can go wrong, always as the service's problem object (RFC 9457) with its advice.

import type { components } from './schema.d.ts';

export type Problem = Omit<components['schemas']['Problem'], 'code'> & { code: string };

/** A request that was answered with a problem, or not answered at all. */
export class Refusal extends Error {
  readonly problem: Problem;

  constructor(problem: Problem) {
    super(problem.detail);
    this.problem = problem;
  }

  /** Whether the service, or the way to it, may be back soon. */
  get passing(): boolean {
    return this.problem.status === 0 || this.problem.status === 503 || this.problem.status === 429;
  }
}

export function problemOf(error: unknown): Problem {
  if (error instanceof Refusal) return error.problem;
  return own('page.error', 'Something went wrong in this page', error instanceof Error ? error.message : String(error));
}

export function own(code: string, title: string, detail: string, advice: string | null = null): Problem {
  return { type: 'about:blank', title, status: 0, detail, code, where: null, advice, instance: null };
}

export function unanswered(): Refusal {
  return new Refusal(
    own('network', 'The service does not answer', 'There was no answer to the request.',
      'Check that the service runs and that this device is online. What was accepted is not lost.'),
  );
}

/** The problem that a response carries. */
export async function refusalOf(response: Response): Promise<Refusal> {
  return refusalFrom(await response.text().catch(() => ''), response.status);
}

export function refusalFrom(body: string, status: number): Refusal {
  try {
    const found = JSON.parse(body) as Partial<Problem>;
    if (found.code && found.title) return new Refusal({ ...own('', '', ''), ...found } as Problem);
  } catch {
    // Not ours: a proxy's page, most likely.
  }
  return new Refusal({ ...own(`http.${status}`, `The answer was ${status}`, 'It came from something before the service.'), status });
}
