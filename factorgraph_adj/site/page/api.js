// Requests to the service. All addresses are relative to that of the page.
const ROOT = new URL("api/v1/", document.baseURI);

export class ApiError extends Error {
  constructor(status, problems, retryAfter) {
    super(problems.map(({ where, what }) => (where ? `${where}: ${what}` : what)).join("\n") || `HTTP ${status}`);
    this.status = status;
    this.problems = problems;
    this.retryAfter = retryAfter;
    this.named = problems.some((p) => p.where); // what is missing is named: the route is there
  }
}

export const address = (path) => new URL(path, ROOT).href;

export async function request(method, path, body) {
  let response;
  try {
    response = await fetch(address(path), {
      method, credentials: "same-origin", cache: "no-store",
      headers: body === undefined ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    throw new ApiError(0, [{ what: String(error.message ?? error) }]);
  }
  const text = await response.text();
  let said = null;
  try { said = text ? JSON.parse(text) : null; } catch { /* a proxy may answer in HTML */ }
  if (response.ok) return said;
  let problems = said?.error ?? said?.detail ?? [];
  if (typeof problems === "string") problems = [{ what: problems }];
  throw new ApiError(response.status, problems.map((p) => ({ where: p.where ?? p.loc?.join(".") ?? "", what: p.what ?? p.msg ?? String(p) })),
    Number(response.headers.get("Retry-After")) || null);
}

export const read = (path) => request("GET", path);

// `crypto.randomUUID` is missing on pages without TLS, such as those of a local network.
export const requestName = () =>
  [...crypto.getRandomValues(new Uint8Array(12))].map((b) => b.toString(16).padStart(2, "0")).join("");

// A command of the stream. It is sent again, under the same name, where the answer did not come:
// the service records it once.
export async function command(network, fields) {
  const posting = { ...fields, request: `page-${requestName()}` };
  for (let attempt = 0; ; attempt++) {
    try {
      const answers = await request("POST", `networks/${encodeURIComponent(network)}/postings`, posting);
      const answer = Array.isArray(answers) ? answers[0] : answers;
      if (answer?.ok === false) throw new ApiError(200, answer.error ?? []);
      return answer;
    } catch (error) {
      const passing = error.status === 0 || error.status === 503;
      if (!passing || attempt >= 2) throw error;
      await new Promise((wait) => setTimeout(wait, 1000 * (error.retryAfter ?? attempt + 1)));
    }
  }
}

let library;
export const plotly = () => (library ??= new Promise((resolve, reject) => {
  const script = document.createElement("script");
  script.src = new URL("page/plotly.min.js", document.baseURI).href;
  script.onload = () => resolve(window.Plotly);
  script.onerror = () => { library = undefined; reject(new Error("plotly.min.js")); };
  document.head.append(script);
}));
