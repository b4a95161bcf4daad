// Runs in the browser's sound thread: makes frames of 16-bit samples of what the microphone hears.

const FRAME_S = 0.05;

class Frames extends AudioWorkletProcessor {
  constructor() {
    super();
    this._frame = new Int16Array(Math.round(FRAME_S * sampleRate));
    this._filled = 0;
    this._loudest = 0;
  }

  process([input]) {
    const samples = input[0];
    if (!samples) return true;
    for (const sample of samples) {
      const bounded = Math.max(-1, Math.min(1, sample));
      this._loudest = Math.max(this._loudest, Math.abs(bounded));
      this._frame[this._filled++] = Math.round(bounded * 32767);
      if (this._filled === this._frame.length) {
        const frame = this._frame.slice();
        this.port.postMessage({ frame: frame.buffer, loudest: this._loudest }, [frame.buffer]);
        this._filled = 0;
        this._loudest = 0;
      }
    }
    return true;
  }
}

registerProcessor("mdb-frames", Frames);
