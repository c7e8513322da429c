// A browser starts no worker for a page that is opened as a file: run the search's worker in a hidden frame.
if (location.protocol === "file:") window.Worker = class extends EventTarget {
  constructor(src) {
    super();
    this.inner = document.body.appendChild(Object.assign(document.createElement("iframe"), { hidden: true })).contentWindow;
    this.inner.document.write("<!doctype html><body></body>");
    this.inner.document.close();
    this.inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
    const script = this.inner.document.createElement("script");
    this.loaded = new Promise((onload) => this.inner.document.body.append(Object.assign(script, { src, onload })));
  }
  postMessage(data) {
    this.loaded.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })));
  }
};
