// Notes as they sound here: a soft tone of each note's pitch, by WebAudio. The brain does not hear this sound.

const LENGTH_S = 0.5;
const LOUDNESS = 0.18;
/** A major scale from middle C, for experiments without an ear. */
const STEPS = [0, 2, 4, 5, 7, 9, 11];

/** The pitch of a note in hertz. `scale_hz`: as the experiment says, or too short. */
export function pitch(note, scale_hz) {
  if (note < (scale_hz?.length ?? 0)) return scale_hz[note];
  return 261.63 * 2 ** (Math.floor(note / 7) + STEPS[note % 7] / 12);
}

export class Sound {
  constructor() {
    this.on = true;
    this._context = null;
  }

  /** Play a note; nothing if sound is off, or if this browser has none. Call it from a click or a key. */
  play(note, scale_hz) {
    if (!this.on || note === null) return;
    const Context = window.AudioContext ?? window.webkitAudioContext;
    if (!Context) return;
    try {
      this._context ??= new Context();
      if (this._context.state === "suspended") this._context.resume().catch(() => {});
      this._tone(pitch(note, scale_hz));
    } catch {
      this._context = null; // no sound device; the page works without
    }
  }

  _tone(hz) {
    const now = this._context.currentTime;
    const loudness = this._context.createGain();
    loudness.gain.setValueAtTime(0, now);
    loudness.gain.linearRampToValueAtTime(LOUDNESS, now + 0.02);
    loudness.gain.exponentialRampToValueAtTime(0.001, now + LENGTH_S);
    loudness.connect(this._context.destination);
    // The second voice, an octave above and soft, makes the tone warmer.
    for (const [times, share] of [[1, 1], [2, 0.25]]) {
      const voice = this._context.createOscillator();
      const part = this._context.createGain();
      voice.frequency.value = hz * times;
      part.gain.value = share;
      voice.connect(part).connect(loudness);
      voice.start(now);
      voice.stop(now + LENGTH_S);
    }
  }
}
