// What stands above every page: where one is, the key, the theme.

import { useSignal } from '@preact/signals';

import { key, remembered, useKey } from '../api/access.ts';
import { route } from '../state/route.ts';
import { refused } from '../state/service.ts';
import { choice, nextTheme } from '../state/theme.ts';

const THEMES = { system: 'Auto', light: 'Light', dark: 'Dark' };

export function Header() {
  const open = useSignal(false);
  const { page } = route.value;
  const wanted = refused.value?.code === 'access.denied' && page !== 'shared';
  return (
    <>
      <header class="top">
        <a class="brand" href="#/">Metric-Phase Fields</a>
        <nav aria-label="Pages">
          <a href="#/" aria-current={page === 'new' ? 'page' : undefined}>New</a>
          <a href="#/jobs" aria-current={page === 'jobs' ? 'page' : undefined}>Jobs</a>
        </nav>
        <div class="right">
          <button type="button" aria-expanded={open.value || wanted} onClick={() => (open.value = !open.value)}>
            {key.value ? 'Key set' : 'Key'}
          </button>
          <button type="button" aria-label={`${THEMES[choice.value]} colours; change`} onClick={nextTheme}>
            {THEMES[choice.value]}
          </button>
        </div>
      </header>
      {(open.value || wanted) && <KeyForm close={() => (open.value = false)} wanted={wanted} />}
    </>
  );
}

function KeyForm({ close, wanted }: { close: () => void; wanted: boolean }) {
  const submit = (event: SubmitEvent) => {
    event.preventDefault();
    const data = new FormData(event.currentTarget as HTMLFormElement);
    useKey(String(data.get('key')).trim(), data.get('remember') !== null);
    close();
  };
  return (
    <form class="key" aria-label="API key" onSubmit={submit}>
      <p>
        {wanted
          ? `This service asks for an API key${key.value ? ', and the one given is not valid' : ''}.`
          : 'Beyond this machine the service asks for an API key.'}{' '}
        Its operator makes one with <code>mpf keys create NAME</code>.
      </p>
      <label>
        Key <input name="key" type="password" autocomplete="off" spellcheck={false} defaultValue={key.value} />
      </label>
      <label class="check">
        <input name="remember" type="checkbox" defaultChecked={remembered.value} /> Keep it on this device, not only in this tab
      </label>
      <button class="main" type="submit">Use it</button>
    </form>
  );
}
