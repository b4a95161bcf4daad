// The microphone: what it hears goes to the server as frames of 16-bit samples, low byte first, one channel.

const RATE_HZ = 16000;
/** What the brain's ear takes. */
const RATES_HZ = [8000, 48000];

/** Why there is no microphone, in words. */
function why(error) {
  const words = {
    NotAllowedError: "The browser does not allow it. Allow the microphone for this page, then try again.",
    NotFoundError: "This computer has no microphone that the browser can use.",
    NotReadableError: "Another program uses the microphone. Close it, then try again.",
  };
  return words[error.name] ?? `The microphone does not start: ${error.message || error.name}.`;
}

export class Microphone {
  /** `onFrame(buffer)` gets 50 ms of sound, `onLoud(share)` how loud it was, 0 to 1. */
  constructor(onFrame, onLoud) {
    this._onFrame = onFrame;
    this._onLoud = onLoud;
    this._stream = null;
    this._context = null;
  }

  get on() {
    return this._context !== null;
  }

  /** Begin to listen. Returns the rate in hertz. Throws an Error in plain words. */
  async start() {
    await this.stop();
    if (!navigator.mediaDevices?.getUserMedia || !window.AudioWorkletNode) {
      throw new Error("The browser gives no microphone to this page. It needs https, or the address 127.0.0.1.");
    }
    try {
      // The browser's own filters are made for speech: they take long notes for noise.
      this._stream = await navigator.mediaDevices.getUserMedia({
        audio: { echoCancellation: false, noiseSuppression: false, autoGainControl: false, channelCount: 1 },
      });
      this._context = await this._listening(RATE_HZ).catch(() => this._listening());
      const rate_hz = Math.round(this._context.sampleRate);
      if (rate_hz < RATES_HZ[0] || rate_hz > RATES_HZ[1]) {
        throw new Error(`it has ${rate_hz} samples in a second, and the ear takes ${RATES_HZ.join(" to ")}`);
      }
      return rate_hz;
    } catch (error) {
      await this.stop();
      throw new Error(why(error));
    }
  }

  /** A context in which frames come; without a rate: at the microphone's own. */
  async _listening(sampleRate) {
    const context = new AudioContext(sampleRate ? { sampleRate } : {});
    try {
      await context.audioWorklet.addModule(new URL("./worklet.js", import.meta.url));
      const frames = new AudioWorkletNode(context, "mdb-frames", { numberOfOutputs: 0, channelCount: 1, channelCountMode: "explicit" });
      frames.port.onmessage = ({ data }) => {
        if (this._context !== context) return;
        this._onFrame(data.frame);
        this._onLoud(data.loudest);
      };
      context.createMediaStreamSource(this._stream).connect(frames);
      await context.resume();
      return context;
    } catch (error) {
      await context.close();
      throw error;
    }
  }

  /** Listen no more. */
  async stop() {
    const [context, stream] = [this._context, this._stream];
    this._context = this._stream = null;
    for (const track of stream?.getTracks() ?? []) track.stop();
    if (context && context.state !== "closed") await context.close();
    this._onLoud(0);
  }
}
