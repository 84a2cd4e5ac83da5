// The interactive figure of a run: bodies, force arrows, a slider over time. No library, no network, no global name.
(function (figure) {
  "use strict";
  var data = JSON.parse(figure.querySelector("script[type='application/json']").textContent);
  var canvas = figure.querySelector("canvas"), still = figure.querySelector("img");
  var gl = null;
  try {
    gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  } catch (error) { gl = null; }
  if (!gl) { return; } // The still picture stays.

  // Numbers: [kind, offset in bytes, length, scale].
  var bytes = Uint8Array.from(atob(data.blob), function (c) { return c.charCodeAt(0); }).buffer;
  function numbers(entry) {
    var kinds = { f: Float32Array, h: Int16Array, H: Uint16Array, b: Int8Array };
    return new kinds[entry[0]](bytes, entry[1], entry[2]);
  }
  // One row of a table over frames, between two frames; a table of one row does not move.
  function table(entry, width) {
    var values = numbers(entry), rows = values.length / width, scale = entry[3] || 1;
    return function (i, f, out) {
      var a = rows > 1 ? i * width : 0, b = rows > 1 ? Math.min(i + 1, rows - 1) * width : 0, k;
      for (k = 0; k < width; k++) { out[k] = scale * (values[a + k] * (1 - f) + values[b + k] * f); }
      return out;
    };
  }

  // Vectors and turns.
  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  function sum(a, s, b) { return [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]; }
  function unit(a) { var l = Math.sqrt(dot(a, a)) || 1; return [a[0] / l, a[1] / l, a[2] / l]; }
  function product(a, b) { // Quaternions, scalar first.
    return [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
      a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];
  }
  function turning(v, s) { // Quaternion of a rotation vector, s times as far.
    var angle = s * Math.sqrt(dot(v, v)), share = angle ? Math.sin(angle / 2) / angle * s : 0.5 * s;
    return [Math.cos(angle / 2), v[0] * share, v[1] * share, v[2] * share];
  }
  function columns(q) { // Matrix of a quaternion of any length, by columns.
    var w = q[0], x = q[1], y = q[2], z = q[3], n = 2 / (w * w + x * x + y * y + z * z);
    return [1 - n * (y * y + z * z), n * (x * y + w * z), n * (x * z - w * y), n * (x * y - w * z), 1 - n * (x * x + z * z),
      n * (y * z + w * x), n * (x * z + w * y), n * (y * z - w * x), 1 - n * (x * x + y * y)];
  }

  // The program.
  var vertex = "attribute vec3 p,n,k;uniform mat4 V;uniform mat3 R,N;uniform vec3 T;uniform float a,b;varying vec3 w,m;" +
    "void main(){vec3 q=R*(p*a+k*b)+T;w=q;m=N*n;gl_Position=V*vec4(q,1.);}";
  var fragment = "precision mediump float;varying vec3 w,m;uniform vec3 E,L;uniform vec4 C;uniform float F;" +
    "void main(){vec3 n=normalize(m);if(dot(n,E)<0.)n=-n;float d=max(dot(n,L),0.);float r=max(dot(n,normalize(L+E)),0.);" +
    "vec3 c=C.rgb*mix(.42+.62*d,1.,F)+(1.-F)*.22*pow(r,28.);gl_FragColor=vec4(c*C.a,C.a);}";
  function shader(kind, text) {
    var s = gl.createShader(kind);
    gl.shaderSource(s, text);
    gl.compileShader(s);
    return s;
  }
  var program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) { return; }
  gl.useProgram(program);
  var at = {};
  "pnk".split("").forEach(function (x) { at[x] = gl.getAttribLocation(program, x); });
  "VRNTabELCF".split("").forEach(function (x) { at[x] = gl.getUniformLocation(program, x); });

  function buffer(values, target) {
    var made = gl.createBuffer();
    gl.bindBuffer(target || gl.ARRAY_BUFFER, made);
    gl.bufferData(target || gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return made;
  }
  var SHORT = gl.SHORT, BYTE = gl.BYTE, FLOAT = gl.FLOAT;
  var meshes = data.meshes.map(function (m) {
    var index = numbers(m.t);
    return {
      p: buffer(numbers(m.p)), kind: SHORT, a: m.p[3], n: buffer(numbers(m.n)),
      k: m.k ? buffer(numbers(m.k)) : null, b: m.k ? m.k[3] : 0, t: buffer(index, gl.ELEMENT_ARRAY_BUFFER), count: index.length
    };
  });
  // A cone frustum along z of unit size: shaft and point of an arrow.
  function frustum(low, high) {
    var p = [], n = [], t = [], i, c, s, count = 14;
    for (i = 0; i <= count; i++) {
      c = Math.cos(2 * Math.PI * i / count); s = Math.sin(2 * Math.PI * i / count);
      p.push(low * c, low * s, 0, high * c, high * s, 1);
      n.push(127 * c, 127 * s, 0, 127 * c, 127 * s, 0);
      if (i < count) { t.push(2 * i, 2 * i + 2, 2 * i + 1, 2 * i + 1, 2 * i + 2, 2 * i + 3); }
    }
    return {
      p: buffer(new Float32Array(p)), kind: FLOAT, a: 1, n: buffer(new Int8Array(n)), k: null, b: 0,
      t: buffer(new Uint16Array(t), gl.ELEMENT_ARRAY_BUFFER), count: t.length
    };
  }
  var shaft = frustum(1, 1), tip = frustum(1, 0);

  function paint(mesh, turn, normals, place, colour, flat, slack) {
    gl.uniformMatrix3fv(at.R, false, turn);
    gl.uniformMatrix3fv(at.N, false, normals);
    gl.uniform3fv(at.T, place);
    gl.uniform4fv(at.C, colour);
    gl.uniform1f(at.F, flat);
    gl.uniform1f(at.a, mesh.a);
    gl.uniform1f(at.b, mesh.b * slack);
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.p);
    gl.vertexAttribPointer(at.p, 3, mesh.kind, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.n);
    gl.vertexAttribPointer(at.n, 3, BYTE, true, mesh.kind === SHORT ? 4 : 0, 0);
    if (mesh.k) {
      gl.enableVertexAttribArray(at.k);
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.k);
      gl.vertexAttribPointer(at.k, 3, BYTE, false, 4, 0);
    } else {
      gl.disableVertexAttribArray(at.k);
      gl.vertexAttrib3f(at.k, 0, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.t);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
  }

  // What moves.
  var tracks = data.tracks.map(function (t) {
    return { name: t.name, p: table(t.p, 3), q: table(t.q, 4), d: table(t.d, 3), r: table(t.r, 3) };
  });
  var forces = data.forces.map(function (f) { return { contact: f.contact, track: f.track, p: table(f.p, 3), f: table(f.f, 3) }; });
  var times = numbers(data.times), last = times.length - 1;
  var shown = {}, frame = data.start, factor = data.exaggeration, playing = false;
  var wide = data.eye, up = unit(data.up);
  var home = { az: 0, el: Math.asin(dot(unit(wide), up)), zoom: 1, x: 0, y: 0 }, camera;
  var first = unit(sum(wide, -dot(wide, up), up)), second = cross(up, first);
  function reset() { camera = { az: home.az, el: home.el, zoom: home.zoom, x: home.x, y: home.y }; }
  reset();

  function pose(t, i, f) {
    var p = t.p(i, f, []), d = t.d(i, f, []), q = t.q(i, f, []), r = t.r(i, f, []);
    return { place: sum(p, factor, d), turn: columns(product(turning(r, factor), q)) };
  }
  var ground = { place: [0, 0, 0], turn: [1, 0, 0, 0, 1, 0, 0, 0, 1] };

  function look(aspect) {
    var c = Math.cos(camera.el), s = Math.sin(camera.el);
    var way = [0, 1, 2].map(function (k) { return c * (Math.cos(camera.az) * first[k] + Math.sin(camera.az) * second[k]) + s * up[k]; });
    var right = unit(cross(up, way)), over = cross(way, right), h = data.half;
    var lens = 0.27; // Tangent of half the angle of view.
    var far = 1.04 * Math.max(h[0] / aspect, h[1]) / lens / camera.zoom + 0.7 * h[2];
    var aim = sum(sum(data.centre, camera.x * data.size, right), camera.y * data.size, over);
    var eye = sum(aim, far, way), size = 3 * Math.sqrt(dot(h, h)), near = Math.max(far - size, 0.01 * far), back = far + size;
    var x = 1 / (lens * aspect), y = 1 / lens, z = -(back + near) / (back - near), zz = -2 * back * near / (back - near);
    return {
      V: [x * right[0], y * over[0], z * way[0], -way[0], x * right[1], y * over[1], z * way[1], -way[1],
        x * right[2], y * over[2], z * way[2], -way[2],
        -x * dot(right, eye), -y * dot(over, eye), -z * dot(way, eye) + zz, dot(way, eye)],
      E: way, L: unit(sum(sum(way, 0.55, over), -0.45, right))
    };
  }

  // A colour for a share of the largest force, by the legend's stops.
  function shade(share) {
    var s = data.colours, x = Math.min(share, 1) * (s.length - 1), i = Math.min(Math.floor(x), s.length - 2), f = x - i;
    return [0, 1, 2].map(function (k) { return s[i][k] * (1 - f) + s[i + 1][k] * f; });
  }

  function draw() {
    var ratio = Math.min(window.devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) { return; }
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    var seen = look(w / h), i = Math.min(Math.floor(frame), last), f = frame - i, most = 0, name = "";
    var poses = tracks.map(function (t) { return pose(t, i, f); });
    gl.viewport(0, 0, w, h);
    gl.clearColor(1, 1, 1, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.depthFunc(gl.LEQUAL);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.enableVertexAttribArray(at.p);
    gl.enableVertexAttribArray(at.n);
    gl.uniformMatrix4fv(at.V, false, seen.V);
    gl.uniform3fv(at.E, seen.E);
    gl.uniform3fv(at.L, seen.L);
    function bodies(solid) {
      data.parts.forEach(function (part) {
        var colour = data.tones[part.tone], own = part.track < 0 ? ground : poses[part.track];
        if ((colour[3] === 1) !== solid || shown["b" + part.body] === false) { return; }
        paint(meshes[part.mesh], own.turn, own.turn, own.place, colour, 0, factor - 1);
      });
    }
    function arrows(alpha) {
      forces.forEach(function (force) {
        var v = force.f(i, f, []), size = Math.sqrt(dot(v, v)), share = Math.sqrt(size / data.peak);
        if (size < data.least * data.peak || shown["c" + force.contact] === false) { return; }
        if (size > most) { most = size; name = force.contact; }
        var way = unit(v), side = unit(cross(way, Math.abs(way[2]) < 0.8 ? [0, 0, 1] : [1, 0, 0])), other = cross(way, side);
        var long = share * data.arrow, head = Math.min(0.3 * data.arrow, 0.6 * long), r = 0.026 * data.arrow;
        var point = sum(force.p(i, f, []), 1, force.track < 0 ? ground.place : poses[force.track].place);
        var colour = shade(share).concat([alpha]);
        function part(mesh, from, length, radius) {
          var turn = [], normals = [], k;
          for (k = 0; k < 3; k++) {
            turn[k] = side[k] * radius; turn[3 + k] = other[k] * radius; turn[6 + k] = way[k] * length;
            normals[k] = side[k]; normals[3 + k] = other[k]; normals[6 + k] = way[k];
          }
          paint(mesh, turn, normals, sum(point, -from, way), colour, 0.55, 0);
        }
        part(shaft, long, long - head, r);
        part(tip, head, head, 2.7 * r);
      });
    }
    // From outside one sees through a track to its ball.
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.BACK);
    bodies(true);
    gl.disable(gl.CULL_FACE);
    arrows(1);
    // What a body hides of an arrow shines through.
    gl.depthFunc(gl.GREATER);
    gl.depthMask(false);
    arrows(0.3);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.FRONT);
    bodies(false);
    gl.cullFace(gl.BACK);
    bodies(false);
    gl.disable(gl.CULL_FACE);
    gl.depthMask(true);
    var t = times[i] * (1 - f) + times[Math.min(i + 1, last)] * f;
    clock.textContent = text(t, data.clock) + (most ? ", largest force " + text(most, data.newton) + " (" + name + ")" : ", no force");
    slider.setAttribute("aria-valuetext", text(t, data.clock));
  }
  function text(value, unit) { return (value * unit[0]).toFixed(unit[2]) + " " + unit[1]; }

  // Controls.
  function one(name) { return figure.querySelector("[data-bcfj='" + name + "']"); }
  var play = one("play"), slider = one("time"), clock = one("clock"), scale = one("scale"), words = one("words");
  var asked = false, then = 0;
  function refresh() { if (!asked) { asked = true; requestAnimationFrame(tick); } }
  function tick(now) {
    asked = false;
    if (playing) {
      var t = times[0] + ((times[last] - times[0]) * clockOf(now)) % (times[last] - times[0] || 1), i = Math.floor(frame);
      if (i >= last || times[i] > t) { i = 0; }
      while (i < last - 1 && times[i + 1] <= t) { i++; }
      frame = i + Math.min(Math.max((t - times[i]) / (times[i + 1] - times[i]), 0), 1);
      slider.value = Math.round(frame);
      refresh();
    }
    draw();
  }
  function clockOf(now) { return (now - then) / 1000 / data.lasts; }
  function start(on) {
    playing = on;
    play.textContent = on ? "Pause" : "Play";
    var i = Math.min(Math.floor(frame), last), t = times[i] + (frame - i) * ((times[i + 1] || times[i]) - times[i]);
    if (i >= last) { t = times[0]; }
    then = performance.now() - 1000 * data.lasts * (t - times[0]) / (times[last] - times[0] || 1);
    refresh();
  }
  play.addEventListener("click", function () { start(!playing); });
  slider.max = last;
  slider.value = frame;
  slider.addEventListener("input", function () { start(false); frame = +slider.value; refresh(); });
  function sized() {
    factor = data.steps[+scale.value] || 1;
    words.textContent = factor === 1 ? "true to scale" : factor + " times as large as they are";
    scale.setAttribute("aria-valuetext", words.textContent);
    refresh();
  }
  if (scale) {
    scale.max = data.steps.length - 1;
    scale.value = data.steps.indexOf(data.exaggeration);
    scale.addEventListener("input", sized);
    sized();
  }
  one("home").addEventListener("click", function () { reset(); refresh(); });
  figure.querySelectorAll("input[type='checkbox']").forEach(function (box) {
    box.addEventListener("change", function () { shown[box.value] = box.checked; refresh(); });
  });

  // Mouse, touch and keys. A vertical stroke of one finger scrolls the page; the wheel zooms once the picture has the focus.
  var fingers = {}, apart = 0;
  function spread() {
    var p = Object.keys(fingers).map(function (k) { return fingers[k]; });
    return p.length > 1 ? Math.sqrt(Math.pow(p[0][0] - p[1][0], 2) + Math.pow(p[0][1] - p[1][1], 2)) : 0;
  }
  function orbit(x, y) {
    camera.az -= x;
    camera.el = Math.max(-1.55, Math.min(1.55, camera.el + y));
    refresh();
  }
  function zoom(by) { camera.zoom = Math.max(0.3, Math.min(30, camera.zoom * by)); refresh(); }
  function shift(x, y) { camera.x += x / camera.zoom; camera.y += y / camera.zoom; refresh(); }
  canvas.addEventListener("pointerdown", function (e) {
    fingers[e.pointerId] = [e.clientX, e.clientY];
    apart = spread();
    canvas.setPointerCapture(e.pointerId);
  });
  canvas.addEventListener("pointermove", function (e) {
    var old = fingers[e.pointerId];
    if (!old) { return; }
    var x = e.clientX - old[0], y = e.clientY - old[1];
    fingers[e.pointerId] = [e.clientX, e.clientY];
    if (Object.keys(fingers).length > 1) {
      var now = spread();
      if (apart && now) { zoom(now / apart); }
      apart = now;
    } else if (e.shiftKey || e.buttons === 2) { shift(-x / canvas.clientWidth, y / canvas.clientWidth); } else { orbit(x / 150, y / 150); }
  });
  ["pointerup", "pointercancel"].forEach(function (kind) {
    canvas.addEventListener(kind, function (e) { delete fingers[e.pointerId]; apart = spread(); });
  });
  canvas.addEventListener("contextmenu", function (e) { e.preventDefault(); });
  canvas.addEventListener("wheel", function (e) {
    if (document.activeElement !== canvas) { return; }
    e.preventDefault();
    zoom(Math.exp(-0.0015 * e.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", function (e) {
    var keys = {
      ArrowLeft: [orbit, -0.1, 0], ArrowRight: [orbit, 0.1, 0], ArrowUp: [orbit, 0, 0.1], ArrowDown: [orbit, 0, -0.1],
      "+": [zoom, 1.2], "=": [zoom, 1.2], "-": [zoom, 1 / 1.2], " ": [start, !playing],
      ".": [step, 1], ",": [step, -1], Home: [function () { reset(); refresh(); }]
    }, found = keys[e.key];
    if (!found || e.ctrlKey || e.metaKey || e.altKey) { return; }
    e.preventDefault();
    if (e.shiftKey && found[0] === orbit) { shift(0.5 * found[1], 0.5 * found[2]); } else { found[0](found[1], found[2]); }
  });
  function step(by) {
    start(false);
    frame = Math.max(0, Math.min(last, Math.round(frame) + by));
    slider.value = frame;
    refresh();
  }
  canvas.addEventListener("webglcontextlost", function (e) {
    e.preventDefault();
    playing = false;
    figure.classList.remove("bcfj-live");
  });
  figure.classList.add("bcfj-live");
  still.setAttribute("aria-hidden", "true");
  if (window.ResizeObserver) { new ResizeObserver(refresh).observe(canvas); } else { window.addEventListener("resize", refresh); }
  draw();
})(document.currentScript.parentElement);
