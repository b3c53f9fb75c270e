// Asks the server, with the person's token where there is one. The token lives in this tab only.

const KEPT = "leeway token";

export const token = {
  get: () => sessionStorage.getItem(KEPT),
  set: (value) => (value ? sessionStorage.setItem(KEPT, value) : sessionStorage.removeItem(KEPT)),
};

export function headers() {
  return token.get() ? { authorization: `Bearer ${token.get()}` } : {};
}

// The answer, or null where the server is not there.
export function ask(address, options = {}) {
  return fetch(address, { ...options, headers: { ...options.headers, ...headers() } }).catch(() => null);
}

export function post(address, content) {
  return ask(address, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify(content),
  });
}
