import { render } from 'preact';

import { App } from './App.tsx';
import './state/theme.ts';

const root = document.getElementById('app') as HTMLElement;
root.replaceChildren();
render(<App />, root);
