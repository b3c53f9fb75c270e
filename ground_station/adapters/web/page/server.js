// Requests to the server, with the user's token if there is one. The token is stored per tab.

const KEPT = "leeway token";

export const token = {
  get: () => sessionStorage.getItem(KEPT),
  set: (value) => (value ? sessionStorage.setItem(KEPT, value) : sessionStorage.removeItem(KEPT)),
};

export function headers() {
  return token.get() ? { authorization: `Bearer ${token.get()}` } : {};
}

// Returns the response, or null if the server is unreachable.
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
