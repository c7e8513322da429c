// A browser starts no worker for a page that is opened as a file: run the search's worker in a hidden frame.
window.IFrameWorker = class extends EventTarget {
  constructor(url) {
    super();
    const frame = document.body.appendChild(Object.assign(document.createElement("iframe"), { hidden: true }));
    const inner = (this.inner = frame.contentWindow);
    inner.document.write("<!doctype html><body></body>");
    inner.document.close();
    const load = (src) => new Promise((onload) =>
      inner.document.body.append(Object.assign(inner.document.createElement("script"), { src, onload })));
    inner.importScripts = (...urls) => urls.reduce((last, next) => last.then(() => load(next)), Promise.resolve());
    inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
    this.loaded = load(url);
  }
  postMessage(data) {
    this.loaded.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })));
  }
};
if (location.protocol === "file:") window.Worker = window.IFrameWorker;
