// The search, for a site that is read from a folder: browsers start no Worker for a page that is a file, so the
// Worker's script runs in a hidden frame of the page. Material for MkDocs asks for it by the name IFrameWorker.
class IFrameWorker extends EventTarget {
  constructor(url) {
    super();
    this.frame = document.createElement("iframe");
    this.frame.hidden = true;
    this.ready = new Promise(resolve => { this.frame.onload = resolve; }).then(() => this.run(url));
    document.body.append(this.frame);
  }

  // What a Worker's script finds in its global scope, and then the script.
  run(url) {
    this.inside = this.frame.contentWindow;
    this.inside.postMessage = data => this.dispatchEvent(new MessageEvent("message", {data}));
    this.inside.importScripts = async (...urls) => { for (const each of urls) await this.load(each); };
    return this.load(url);
  }

  load(url) {
    return new Promise((resolve, reject) => {
      const script = this.inside.document.createElement("script");
      Object.assign(script, {src: url, onload: resolve, onerror: () => reject(new Error(`${url}: not loaded`))});
      this.inside.document.body.append(script);
    });
  }

  async postMessage(data) {
    await this.ready;
    this.inside.dispatchEvent(new MessageEvent("message", {data}));
  }

  terminate() {
    this.frame.remove();
  }
}

window.IFrameWorker = IFrameWorker;
if (location.protocol === "file:") window.Worker = IFrameWorker;
