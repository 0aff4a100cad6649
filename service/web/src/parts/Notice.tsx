// A problem, with what to do about it.

import type { Problem } from '../api/problem.ts';

export function Notice({ problem, again }: { problem: Problem; again?: () => void }) {
  return (
    <div class="notice" role="alert">
      <strong>{problem.title}</strong>
      <p>
        {sentence(problem.detail)}
        {problem.where && <> ({problem.where})</>}
      </p>
      {problem.advice && <p class="advice">{problem.advice}</p>}
      <p class="code">
        <code>{problem.code}</code>
        {again && <button type="button" onClick={again}>Try again</button>}
      </p>
    </div>
  );
}

function sentence(text: string): string {
  const begun = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
