// WebGL2: programs, buffers and one frame. What stands in the buffers is scene.js's affair, the camera orbit.js's.

const POINT_VERTEX = `#version 300 es
precision highp float;
in vec3 place; in vec2 code; in vec3 shift; in vec2 error;
uniform mat4 matrix; uniform vec3 low, step, eye; uniform float shiftStep, adjusted, size, reach;
uniform int mode; uniform vec2 range; uniform float reflectanceStep;
uniform sampler2D scales, groups;
out vec3 colour;
void main() {
  vec3 at = low + place * step + shift * shiftStep * adjusted;
  gl_Position = matrix * vec4(at, 1.0);
  // drawn 6 cm nearer than it lies, so that its own surface does not cut it; no more than a hundredth of its distance
  vec3 away = eye - at;
  vec4 nearer = matrix * vec4(at + away * min(0.01, 0.06 / length(away)), 1.0);
  gl_Position.z = nearer.z / nearer.w * gl_Position.w;
  gl_PointSize = size * clamp(reach / gl_Position.w, 0.7, 3.0);
  float t = -1.0;
  float found = adjusted > 0.5 ? error.y : error.x;
  if (mode == 0 && code.y > 0.5) t = ((code.y - 1.0) * reflectanceStep - range.x) / (range.y - range.x);
  if (mode == 1) t = (at.z - range.x) / (range.y - range.x);
  if (mode == 4 && found > 0.5) t = (found - 1.0) / 254.0;
  if (mode == 2 || mode == 3) colour = texelFetch(groups, ivec2(int(code.x), mode - 2), 0).rgb;
  else if (t < -0.5) colour = vec3(0.45);
  else colour = texture(scales, vec2(clamp(t, 0.0, 1.0) * 0.98 + 0.01, (mode == 4 ? 2.5 : float(mode) + 0.5) / 3.0)).rgb;
  if (mode == 4 && found < 0.5) colour = vec3(0.3);
}`;
const POINT_FRAGMENT = `#version 300 es
precision highp float;
in vec3 colour; out vec4 pixel;
void main() {
  vec2 from = gl_PointCoord - 0.5;
  if (dot(from, from) > 0.25) discard;
  pixel = vec4(colour, 1.0);
}`;
const MESH_VERTEX = `#version 300 es
precision highp float;
in vec3 at; in vec3 normal; in vec4 tint;
uniform mat4 matrix;
out vec3 facing, place; out vec4 colour;
void main() { gl_Position = matrix * vec4(at, 1.0); facing = normal; place = at; colour = tint; }`;
const MESH_FRAGMENT = `#version 300 es
precision highp float;
in vec3 facing, place; in vec4 colour; out vec4 pixel;
uniform vec3 eye; uniform float contrast;
void main() {
  vec3 n = normalize(facing);
  if (dot(n, eye - place) < 0.0) n = -n;
  float sun = max(dot(n, normalize(vec3(-0.55, 0.45, 0.7))), 0.0);
  float light = 0.42 + 0.14 * n.z + 0.55 * sun;
  pixel = vec4(colour.rgb * mix(1.0, light, contrast), colour.a);
}`;
const LINE_VERTEX = `#version 300 es
precision highp float;
in vec3 from, to; in vec4 tint; in float width;
uniform mat4 matrix; uniform vec2 screen;
out vec4 colour;
void main() {
  vec4 a = matrix * vec4(from, 1.0), b = matrix * vec4(to, 1.0);
  float near = 0.05;
  if (a.w < near && b.w < near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (a.w < near) a = mix(a, b, (near - a.w) / (b.w - a.w));
  if (b.w < near) b = mix(b, a, (near - b.w) / (a.w - b.w));
  vec2 along = (b.xy / b.w - a.xy / a.w) * screen;
  vec2 side = length(along) > 1e-6 ? normalize(vec2(-along.y, along.x)) : vec2(1.0, 0.0);
  vec4 end = gl_VertexID < 2 ? a : b;
  float sign = (gl_VertexID & 1) == 0 ? -1.0 : 1.0;
  gl_Position = end + vec4(sign * side * width / screen * end.w, 0.0, 0.0);
  colour = tint;
}`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 colour; out vec4 pixel;
void main() { pixel = colour; }`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || 'shader');
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || 'program');
  const places = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const name = gl.getActiveUniform(made, i).name;
    places[name] = gl.getUniformLocation(made, name);
  }
  return { made, places };
}

// One interleaved buffer; `fields`: [name, count, type, offset].
function vertexArray(gl, held, data, stride, fields, options = {}) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  for (const [name, count, type, offset, normalised] of fields) {
    const at = gl.getAttribLocation(held.made, name);
    if (at < 0) continue;
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, count, type, normalised || false, stride, offset);
    if (options.instanced) gl.vertexAttribDivisor(at, 1);
  }
  if (options.indices) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, options.indices, gl.STATIC_DRAW);
  }
  gl.bindVertexArray(null);
  return { array, buffer, count: options.indices ? options.indices.length : data.byteLength / stride };
}

class Painter {
  constructor(canvas) {
    const gl = canvas.getContext('webgl2', { antialias: true, powerPreference: 'high-performance' });
    if (!gl) throw new Error('no WebGL2');
    this.gl = gl;
    this.canvas = canvas;
    this.points = program(gl, POINT_VERTEX, POINT_FRAGMENT);
    this.mesh = program(gl, MESH_VERTEX, MESH_FRAGMENT);
    this.line = program(gl, LINE_VERTEX, LINE_FRAGMENT);
  }

  texture(width, height, data, smooth) {
    const gl = this.gl, made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, width, height, 0, gl.RGB, gl.UNSIGNED_BYTE, data);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, smooth ? gl.LINEAR : gl.NEAREST], [gl.TEXTURE_MAG_FILTER, smooth ? gl.LINEAR : gl.NEAREST],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    return made;
  }

  meshArray(data, indices) {
    const gl = this.gl;
    return vertexArray(gl, this.mesh, data, 28, [
      ['at', 3, gl.FLOAT, 0], ['normal', 3, gl.FLOAT, 12], ['tint', 4, gl.UNSIGNED_BYTE, 24, true],
    ], { indices });
  }

  lineArray(data) {
    const gl = this.gl;
    return vertexArray(gl, this.line, data, 32, [
      ['from', 3, gl.FLOAT, 0], ['to', 3, gl.FLOAT, 12], ['tint', 4, gl.UNSIGNED_BYTE, 24, true], ['width', 1, gl.FLOAT, 28],
    ], { instanced: true });
  }

  pointArray(data) {
    const gl = this.gl;
    return vertexArray(gl, this.points, data, 16, [
      ['place', 3, gl.UNSIGNED_SHORT, 0], ['code', 2, gl.UNSIGNED_BYTE, 6], ['shift', 3, gl.BYTE, 8], ['error', 2, gl.UNSIGNED_BYTE, 12],
    ]);
  }

  free(held) {
    if (!held) return;
    this.gl.deleteVertexArray(held.array);
    this.gl.deleteBuffer(held.buffer);
  }

  begin(colour) {
    const gl = this.gl;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...colour, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  drawMesh(held, view, contrast, behind) {
    const gl = this.gl;
    gl.useProgram(this.mesh.made);
    gl.uniformMatrix4fv(this.mesh.places.matrix, false, view.matrix);
    gl.uniform3fv(this.mesh.places.eye, view.eye);
    gl.uniform1f(this.mesh.places.contrast, contrast);
    if (behind) { gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(2, 8); }
    gl.bindVertexArray(held.array);
    gl.drawElements(gl.TRIANGLES, held.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  drawLines(held, view, seeThrough) {
    if (!held || !held.count) return;
    const gl = this.gl;
    gl.useProgram(this.line.made);
    gl.uniformMatrix4fv(this.line.places.matrix, false, view.matrix);
    gl.uniform2f(this.line.places.screen, this.canvas.width, this.canvas.height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    if (seeThrough) gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(held.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, held.count);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
  }

  drawPoints(cloud, view, look) {
    const gl = this.gl, at = this.points.places;
    gl.useProgram(this.points.made);
    gl.uniformMatrix4fv(at.matrix, false, view.matrix);
    gl.uniform3fv(at.eye, view.eye);
    gl.uniform1f(at.shiftStep, cloud.shiftStep);
    gl.uniform1f(at.adjusted, look.adjusted ? 1 : 0);
    gl.uniform1f(at.size, look.size * view.ratio);
    gl.uniform1f(at.reach, view.reach);
    gl.uniform1i(at.mode, look.mode);
    gl.uniform2fv(at.range, look.range);
    gl.uniform1f(at.reflectanceStep, cloud.reflectanceStep);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, cloud.scales);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, cloud.groups);
    gl.uniform1i(at.scales, 0);
    gl.uniform1i(at.groups, 1);
    gl.bindVertexArray(cloud.held.array);
    for (const tile of cloud.tiles) {
      gl.uniform3fv(at.low, tile.low);
      gl.uniform3fv(at.step, tile.step);
      gl.drawArrays(gl.POINTS, tile.first, Math.ceil(tile.count * look.share));
    }
  }
}
