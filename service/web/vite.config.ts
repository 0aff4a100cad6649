import { defineConfig } from 'vite';

// Everything is a file of this origin, so that the page's policy needs no exceptions: nothing is
// inlined, and what a page needs first is not kept back by what draws in 3-D.
export default defineConfig({
  base: './',
  build: {
    outDir: 'static',
    emptyOutDir: true,
    target: 'es2022',
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
  },
  worker: { format: 'es' },
  server: {
    // `npm run dev` beside `mpf serve`.
    proxy: Object.fromEntries(
      ['/jobs', '/uploads', '/inspect', '/shared', '/capabilities', '/readyz'].map((path) => [
        path,
        { target: 'http://127.0.0.1:8000', changeOrigin: true },
      ]),
    ),
  },
});
