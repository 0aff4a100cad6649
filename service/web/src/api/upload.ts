// Uploads in pieces, by tus: what has arrived counts, whatever happens to connection or service.

import { DetailedError, Upload } from 'tus-js-client';

import { authorization } from './access.ts';
import { refusalFrom, unanswered, type Refusal } from './problem.ts';

const PIECE_BYTES = 16 * 2 ** 20;
const PAUSES = [0, 500, 1000, 2000, 4000, 8000, 15_000, 15_000, 30_000, 30_000];

export interface Sending {
  /** The upload's href; rejects with Refusal. */
  done: Promise<string>;
  abort: () => void;
}

export function send(
  file: File, href: string, onProgress: (sent: number, all: number) => void, onPause: () => void,
): Sending {
  let abort = () => {};
  const done = new Promise<string>((resolve, reject) => {
    const upload = new Upload(file, {
      endpoint: href,
      chunkSize: PIECE_BYTES,
      retryDelays: PAUSES,
      headers: authorization(),
      metadata: { filename: file.name },
      // An accepted job takes its upload away, and two jobs may come from one file.
      removeFingerprintOnSuccess: true,
      onProgress,
      onShouldRetry: (error) => {
        const status = error.originalResponse?.getStatus() ?? 0;
        const again = status === 0 || status === 423 || status === 409 || status >= 500;
        if (again && status !== 507) onPause();
        return again && status !== 507;
      },
      onSuccess: () => resolve(new URL(upload.url ?? '', location.href).pathname),
      onError: (error) => reject(refusalIn(error)),
    });
    abort = () => {
      void upload.abort(true).catch(() => {});
      reject(new DOMException('The upload was given up.', 'AbortError'));
    };
    upload
      .findPreviousUploads()
      .then(([previous]) => {
        if (previous) upload.resumeFromPreviousUpload(previous);
        upload.start();
      })
      .catch(reject);
  });
  return { done, abort: () => abort() };
}

function refusalIn(error: Error | DetailedError): Refusal {
  const response = error instanceof DetailedError ? error.originalResponse : null;
  return response ? refusalFrom(response.getBody(), response.getStatus()) : unanswered();
}
