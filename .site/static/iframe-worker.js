// A browser starts no worker for a page that is opened as a file. Run the worker of the search in a hidden frame.
window.IFrameWorker = class extends EventTarget {
  constructor(url) {
    super();
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.append(frame);
    const inner = (this.inner = frame.contentWindow);
    inner.document.write("<!doctype html><body></body>");
    inner.document.close();
    const load = (source) => new Promise((resolve) => {
      const script = inner.document.createElement("script");
      Object.assign(script, { src: source, onload: resolve });
      inner.document.body.append(script);
    });
    inner.importScripts = (...sources) => sources.reduce((last, source) => last.then(() => load(source)), Promise.resolve());
    inner.postMessage = (data) => setTimeout(() => this.dispatchEvent(new MessageEvent("message", { data })));
    this.loaded = load(url);
  }
  postMessage(data) {
    this.loaded.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })));
  }
};
if (location.protocol === "file:") window.Worker = window.IFrameWorker;
