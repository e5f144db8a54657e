"use strict";
// The environment's arithmetic: eq. 3 mixes, eq. 4 turns, eq. 1 moves. The same numbers as mixo_env/envs/stepping.py.
const DRIVE = JSON.parse(document.getElementById("drive").textContent);
const STEPS = DRIVE.dt_s.length;
const DEGREES = 180 / Math.PI;

// Eq. 3. With shares, scores are normalised over those who vote; the substitute votes for an expert without an answer,
// or, with hide, nobody does.
function mixed(step, scores, { shares, hide }) {
  const substitute = DRIVE.substitute_rad[step];
  let fused = 0, total = 0, plain = 0, votes = 0;
  DRIVE.claims_rad[step].forEach((claim, j) => {
    if (claim === null && hide) return;
    const increment = claim ?? substitute;
    fused += scores[j] * increment;
    total += scores[j];
    plain += increment;
    votes += 1;
  });
  if (votes === 0) return substitute;
  if (!shares) return fused;
  return total > 0 ? fused / total : plain / votes;
}

class Estimate {
  constructor() {
    this.increments = [];
    this.yaw = [0];
    this.x = [0];
    this.y = [0];
    this.yawErrors = [0];
    this.sums = { position: 0, yaw: 0, step: 0, piece: 0 };
    this.pieces = 0;
  }

  get step() { return this.increments.length; }

  advance(scores, rules) {
    const k = this.step;
    const fused = mixed(k, scores, rules);
    const yaw = this.yaw[k] + fused; // eq. 4
    const course = DRIVE.course_rad + this.yaw[k] + 0.5 * fused; // eq. 1: along the yaw in the middle of the step
    this.increments.push(fused);
    this.yaw.push(yaw);
    this.x.push(this.x[k] + DRIVE.distance_m[k] * Math.cos(course));
    this.y.push(this.y[k] + DRIVE.distance_m[k] * Math.sin(course));
    this.judge(k);
  }

  judge(k) {
    const truth = DRIVE.truth;
    const error = this.yaw[k + 1] - truth.yaw_rad[k];
    this.yawErrors.push(error);
    this.sums.yaw += error ** 2;
    this.sums.step += (this.increments[k] - truth.increment_rad[k]) ** 2;
    this.sums.position += (this.x[k + 1] - truth.x_m[k]) ** 2 + (this.y[k + 1] - truth.y_m[k]) ** 2;
    const { start, end, length_m } = DRIVE.pieces; // sorted by their end
    for (; this.pieces < end.length && end[this.pieces] <= k + 1; this.pieces++) {
      const grown = error - this.yawErrors[start[this.pieces]];
      const wrapped = Math.abs(Math.atan2(Math.sin(grown), Math.cos(grown)));
      this.sums.piece += (wrapped * DEGREES) / length_m[this.pieces];
    }
  }

  scores() {
    const k = this.step;
    return {
      now_deg: this.yawErrors[k] * DEGREES,
      ate_deg: Math.sqrt(this.sums.yaw / (k + 1)) * DEGREES, // the exact first pose counts
      ate_m: Math.sqrt(this.sums.position / (k + 1)),
      rte_deg_per_m: this.pieces ? this.sums.piece / this.pieces : null,
      yaw_rmse_deg: k ? Math.sqrt(this.sums.step / k) * DEGREES : null,
    };
  }
}
