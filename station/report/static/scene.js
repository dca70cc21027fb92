"use strict";
// Small 3D scene: shaded surfaces and lines of constant width, with a camera that mouse, touch or keyboard moves.
// Units are metres; x points down on the screen, in the direction of gravity.

const VERTEX = `
attribute vec3 vertex; attribute vec3 normal;
uniform mat4 view; varying vec3 facing;
void main() { facing = normal; gl_Position = view * vec4(vertex, 1.0); }`;
const SHADED = `
precision mediump float; uniform vec3 colour; uniform vec3 light; varying vec3 facing;
void main() {
  float along = abs(dot(normalize(facing), light));
  gl_FragColor = vec4(colour * (0.45 + 0.6 * along), 1.0);
}`;
// A segment has four corners; each corner has both ends of the segment and its side of the line.
const LINE_VERTEX = `
attribute vec3 start; attribute vec3 end; attribute vec2 corner; attribute float moment;
uniform mat4 view; uniform vec2 size; uniform float width; varying float when;
void main() {
  vec4 a = view * vec4(start, 1.0); vec4 b = view * vec4(end, 1.0);
  vec2 along = (b.xy / b.w - a.xy / a.w) * size;
  vec2 side = length(along) > 1e-4 ? normalize(vec2(-along.y, along.x)) : vec2(0.0, 1.0);
  vec4 at = corner.x > 0.5 ? b : a;
  gl_Position = at + vec4(corner.y * side * width / size * at.w, 0.0, 0.0);
  when = moment;
}`;
const LINE_COLOUR = `
precision mediump float; uniform vec3 colour; uniform vec2 shown; varying float when;
void main() {
  if (when < shown.x || when > shown.y) discard;
  gl_FragColor = vec4(colour, 1.0);
}`;

const add = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = (a) => { const l = Math.hypot(...a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };

/** Rings around a line of points: a tube with flat ends, as {vertices, normals}. */
function tubeSurface(points, radius, sides = 12) {
  const vertices = [], normals = [];
  let x = unit(Math.abs(unit(add(points[1], points[0], -1))[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
  const rings = points.map((point, k) => {
    const along = unit(add(points[Math.min(k + 1, points.length - 1)], points[Math.max(k - 1, 0)], -1));
    x = unit(add(x, along, -dot(x, along)));
    const y = cross(along, x);
    return Array.from({ length: sides + 1 }, (_, s) => {
      const angle = (2 * Math.PI * s) / sides;
      const normal = add([0, 0, 0].map((_, i) => Math.cos(angle) * x[i]), y, Math.sin(angle));
      return [add(point, normal, radius), normal];
    });
  });
  const put = (corner, normal) => { vertices.push(...corner); normals.push(...normal); };
  for (let k = 0; k + 1 < rings.length; k++) {
    for (let s = 0; s < sides; s++) {
      for (const [ring, side] of [[k, s], [k, s + 1], [k + 1, s + 1], [k, s], [k + 1, s + 1], [k + 1, s]]) {
        put(...rings[ring][side]);
      }
    }
  }
  for (const k of [0, rings.length - 1]) {
    const out = unit(add(points[k], points[k ? k - 1 : 1], -1));
    for (let s = 0; s < sides; s++) {
      put(points[k], out); put(rings[k][s][0], out); put(rings[k][s + 1][0], out);
    }
  }
  return { vertices, normals };
}

/** A ball. */
function ballSurface(centre, radius, steps = 10) {
  const vertices = [], normals = [];
  const corner = (a, b) => {
    const [u, v] = [(Math.PI * a) / steps, (2 * Math.PI * b) / steps];
    return [Math.cos(u), Math.sin(u) * Math.cos(v), Math.sin(u) * Math.sin(v)];
  };
  for (let a = 0; a < steps; a++) {
    for (let b = 0; b < steps; b++) {
      for (const [k, n] of [[a, b], [a + 1, b], [a + 1, b + 1], [a, b], [a + 1, b + 1], [a, b + 1]]) {
        const normal = corner(k, n);
        vertices.push(...add(centre, normal, radius));
        normals.push(...normal);
      }
    }
  }
  return { vertices, normals };
}

/** A cone from `base` to `tip`. */
function coneSurface(base, tip, radius, sides = 16) {
  const along = unit(add(tip, base, -1));
  const x = unit(cross(along, Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
  const y = cross(along, x);
  const vertices = [], normals = [];
  for (let s = 0; s < sides; s++) {
    const [a, b] = [s, s + 1].map((n) => {
      const angle = (2 * Math.PI * n) / sides;
      return add([0, 0, 0].map((_, i) => Math.cos(angle) * x[i]), y, Math.sin(angle));
    });
    for (const corner of [[tip, a], [add(base, a, radius), a], [add(base, b, radius), b]]) {
      vertices.push(...corner[0]); normals.push(...corner[1]);
    }
    for (const corner of [base, add(base, a, radius), add(base, b, radius)]) {
      vertices.push(...corner); normals.push(...along);
    }
  }
  return { vertices, normals };
}

class Scene {
  constructor(canvas, redraw) {
    const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL: the robot cannot be drawn. The numbers are shown.");
    Object.assign(this, { canvas, gl, redraw, target: [0.02, -0.02, 0.1], yaw: 0.9, pitch: 0.35, distance: 0.42 });
    this.surface = this.program(VERTEX, SHADED);
    this.line = this.program(LINE_VERTEX, LINE_COLOUR);
    this.scratch = [gl.createBuffer(), gl.createBuffer()];
    this.listen();
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return new Proxy({}, {
      get: (_, name) => name === "program" ? program
        : name.startsWith("u_") ? gl.getUniformLocation(program, name.slice(2)) : gl.getAttribLocation(program, name),
    });
  }

  listen() {
    const pointers = new Map();
    let apart = 0;
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, event);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      pointers.set(event.pointerId, event);
      const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
      if (pointers.size > 1) {
        const [a, b] = [...pointers.values()];
        const now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (apart) this.zoom(apart / now);
        apart = now;
      } else if (event.shiftKey || event.buttons & 6) {
        const { right, up } = this.axes(), k = this.distance / canvas.clientHeight;
        this.target = add(add(this.target, right, -dx * k), up, dy * k);
      } else {
        this.yaw -= 0.008 * dx;
        this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + 0.008 * dy));
      }
      this.redraw();
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => { pointers.delete(event.pointerId); apart = 0; });
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(0.001 * event.deltaY));
      this.redraw();
    }, { passive: false });
  }

  zoom(factor) { this.distance = Math.max(0.03, Math.min(3, this.distance * factor)); }

  axes() {
    // Up on the screen is -x.
    const c = Math.cos(this.pitch);
    const back = [-Math.sin(this.pitch), c * Math.cos(this.yaw + 2.2), c * Math.sin(this.yaw + 2.2)];
    const right = unit(cross([-1, 0, 0], back));
    return { back, right, up: cross(back, right) };
  }

  startFrame(background) {
    const { gl, canvas } = this, ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    gl.viewport(0, 0, w, h);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const { back, right, up } = this.axes(), eye = add(this.target, back, this.distance);
    const f = 1 / Math.tan(0.3), near = 0.01, far = 10;
    const rows = [[right, f * h / w], [up, f], [back, 1]].map(([axis, k]) => [...axis.map((v) => k * v), -k * dot(axis, eye)]);
    const z = rows[2].map((v) => v * (near + far) / (near - far));
    z[3] += 2 * near * far / (near - far);
    const m = [rows[0], rows[1], z, rows[2].map((v) => -v)];
    this.view = new Float32Array(16);
    for (let r = 0; r < 4; r++) for (let c = 0; c < 4; c++) this.view[4 * c + r] = m[r][c];
    this.light = unit(add(back, up, 0.5));
    this.size = [w, h];
    this.ratio = ratio;
  }

  draw({ vertices, normals }, colour) {
    const { gl, surface: p } = this;
    gl.useProgram(p.program);
    gl.uniformMatrix4fv(p.u_view, false, this.view);
    gl.uniform3fv(p.u_colour, colour);
    gl.uniform3fv(p.u_light, this.light);
    [[p.vertex, vertices], [p.normal, normals]].forEach(([at, values], n) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.scratch[n]);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
    });
    gl.drawArrays(gl.TRIANGLES, 0, vertices.length / 3);
    gl.disableVertexAttribArray(p.vertex);
    gl.disableVertexAttribArray(p.normal);
  }

  /** Return lines that are drawn many times: pairs of points, and the time of each pair. */
  lines(pairs, moments) {
    const data = new Float32Array(pairs.length * 54);
    let k = 0;
    pairs.forEach(([a, b], n) => {
      for (const [end, side] of [[0, -1], [0, 1], [1, 1], [0, -1], [1, 1], [1, -1]]) {
        data.set([...a, ...b, end, side, moments ? moments[n] : 0], k);
        k += 9;
      }
    });
    const buffer = this.gl.createBuffer();
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, buffer);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, data, this.gl.STATIC_DRAW);
    return { buffer, corners: 6 * pairs.length };
  }

  drawLines({ buffer, corners }, colour, width, shown = [-1, 1]) {
    const { gl, line: p } = this;
    gl.useProgram(p.program);
    gl.uniformMatrix4fv(p.u_view, false, this.view);
    gl.uniform3fv(p.u_colour, colour);
    gl.uniform2fv(p.u_size, this.size);
    gl.uniform1f(p.u_width, width * this.ratio);
    gl.uniform2fv(p.u_shown, shown);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    const parts = [[p.start, 3, 0], [p.end, 3, 12], [p.corner, 2, 24], [p.moment, 1, 32]];
    for (const [at, count, offset] of parts) {
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, count, gl.FLOAT, false, 36, offset);
    }
    gl.drawArrays(gl.TRIANGLES, 0, corners);
    for (const [at] of parts) gl.disableVertexAttribArray(at);
  }
}
