// The frame around the pages.

import { Header } from './parts/Header.tsx';
import { JobPage } from './pages/JobPage.tsx';
import { JobsPage } from './pages/JobsPage.tsx';
import { NewPage } from './pages/NewPage.tsx';
import { SharedPage } from './pages/SharedPage.tsx';
import { route } from './state/route.ts';

export function App() {
  const at = route.value;
  return (
    <>
      <Header />
      {at.page === 'new' && <NewPage />}
      {at.page === 'jobs' && <JobsPage />}
      {at.page === 'job' && <JobPage key={at.id} id={at.id} />}
      {at.page === 'shared' && <SharedPage key={at.token} token={at.token} />}
    </>
  );
}
