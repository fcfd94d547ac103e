// The connection: requests, and the live stream, which reconnects automatically.

const SILENT_MS = 3000;
const RETRY_MS = 2000;

/** Calls the API. An error has the message of the service and the HTTP status. */
export async function ask(method, path, body) {
  const answer = await fetch("/api/v1" + path, {
    method,
    headers: body === undefined ? {} : { "Content-Type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const text = await answer.text();
  const content = text && answer.headers.get("Content-Type")?.includes("json") ? JSON.parse(text) : null;
  if (answer.ok) {
    if (method !== "GET") window.dispatchEvent(new Event("dbbd:changed"));
    return content;
  }
  const said = content ? [content.error, content.help].filter(Boolean).join("\n") : answer.statusText;
  if (answer.status === 401 && path !== "/session") window.dispatchEvent(new Event("dbbd:sign-in"));
  throw Object.assign(new Error(said), { status: answer.status });
}

/** Receives the live stream. `on` has a function per event, and `up` and `down` for the connection. */
export function hear(on) {
  let source = null;
  let last = performance.now();
  let up = false;
  const set = (now) => {
    if (now !== up) {
      up = now;
      (now ? on.up : on.down)();
    }
  };
  function open() {
    source?.close();
    last = performance.now();
    source = new EventSource("/api/v1/stream");
    for (const name of ["status", "frame", "point", "points", "trace", "mounting", "begin", "job", "lost"]) {
      source.addEventListener(name, (event) => {
        last = performance.now();
        set(true);
        on[name]?.(JSON.parse(event.data));
      });
    }
    source.onerror = () => set(false);
  }
  // Silence shows a broken connection. A refused connection is tried again.
  setInterval(() => {
    const silent = performance.now() - last;
    if (silent > SILENT_MS) set(false);
    if (silent > SILENT_MS + RETRY_MS) open();
  }, 500);
  open();
  return open;
}
