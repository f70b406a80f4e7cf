// Draws the scene of `orbit.py` with three.js. Drag, pinch, wheel and keys turn it and change the distance.
(async () => {
  const figure = document.getElementById("orbit"), canvas = figure.querySelector("canvas");
  const context = canvas.getContext("webgl2", {antialias: true});
  if (!context || !window.DecompressionStream) return;  // the picture below is there without them

  const packed = Uint8Array.from(atob(document.getElementById("orbit-scene").textContent), (byte) => byte.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const room = await new Response(unpacked).json();
  figure.hidden = false;

  const vectors = (steps) => {
    const place = new THREE.Vector3(), step = new THREE.Vector3();
    return Array.from({length: steps.length / 3}, (_, index) =>
      place.add(step.fromArray(steps, 3 * index)).clone().divideScalar(1000));
  };
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(35, 1, 0.05, 1000);
  scene.background = new THREE.Color("#14161c");  // dark in both schemes: bright rays stand out, as in the pictures
  camera.up.set(0, 0, 1);
  const lamp = new THREE.DirectionalLight("white", 0.7);
  scene.add(new THREE.AmbientLight("white", 0.5), lamp);

  for (const {colour, points, triangles} of room.surfaces) {
    let corner = 0;
    const corners = triangles.map((step) => corner += step);
    const geometry = new THREE.BufferGeometry().setFromPoints(vectors(points)).setIndex(corners);
    const faces = new THREE.MeshPhongMaterial({
      color: colour, opacity: 0.16, transparent: true, depthWrite: false, side: THREE.DoubleSide, flatShading: true});
    const lines = new THREE.LineBasicMaterial({color: colour, opacity: 0.7, transparent: true, depthWrite: false});
    const edges = new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), lines);
    scene.add(new THREE.Mesh(geometry, faces), edges);
  }
  const bounds = new THREE.Box3().setFromObject(scene);
  for (const {points} of [...room.groups, ...room.rays]) vectors(points).forEach((point) => bounds.expandByPoint(point));
  bounds.expandByPoint(vectors(room.receiver)[0]);
  const size = bounds.getSize(new THREE.Vector3()).length() || 1, middle = bounds.getCenter(new THREE.Vector3());
  const towards = (turn, tilt) =>
    new THREE.Vector3(Math.cos(tilt) * Math.cos(turn), Math.cos(tilt) * Math.sin(turn), Math.sin(tilt));
  const start = {turn: -1.1, tilt: 0.75, distance: 0};  // radians, metres
  // From this distance all of the room is seen: every corner of its box lies within the picture.
  const fitted = () => {
    const away = towards(start.turn, start.tilt), right = new THREE.Vector3().crossVectors(camera.up, away).normalize();
    const above = new THREE.Vector3().crossVectors(away, right);
    const tall = 0.94 * Math.tan(camera.fov * Math.PI / 360), wide = tall * camera.aspect;
    const distances = [0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
      const [x, y, z] = [1, 2, 4].map((bit) => bounds[corner & bit ? "max" : "min"]);
      const at = new THREE.Vector3(x.x, y.y, z.z).sub(middle);
      return at.dot(away) + Math.max(Math.abs(at.dot(right)) / wide, Math.abs(at.dot(above)) / tall);
    });
    return Math.max(...distances, 0.1 * size);
  };
  camera.aspect = canvas.clientWidth / canvas.clientHeight;
  start.distance = fitted();
  // metres, in the middle of the room as it is first seen
  const pixel = 2 * Math.tan(camera.fov * Math.PI / 360) * start.distance / canvas.clientHeight;

  for (const {colour, points} of room.groups) {
    const geometry = new THREE.BufferGeometry().setFromPoints(vectors(points));
    const width = 1.3 * pixel / Math.tan(camera.fov * Math.PI / 360);  // points do not know the field of view
    scene.add(new THREE.Points(geometry, new THREE.PointsMaterial({color: colour, size: width})));
  }
  // What follows is drawn over the surfaces, each shape over the one before it; weak rays come first.
  let drawn = 0;
  const addOver = (geometry, colour) => {
    const material = new THREE.MeshBasicMaterial({color: colour, depthTest: false, depthWrite: false, transparent: true});
    scene.add(Object.assign(new THREE.Mesh(geometry, material), {renderOrder: ++drawn}));
  };
  const addLine = (points, colour, width) => vectors(points).reduce((start, end) => {
    if (start.distanceTo(end) > 0) {
      addOver(new THREE.TubeGeometry(new THREE.LineCurve3(start, end), 1, width, 6), colour);
    }
    return end;
  });
  const addBall = (point, colour) =>
    addOver(new THREE.SphereGeometry(6 * pixel, 24, 16).translate(...vectors(point)[0].toArray()), colour);
  for (const {colour, points} of room.rays) addLine(points, colour, pixel);
  addLine(room.boresight, "#d55e00", 1.6 * pixel);
  addBall(room.receiver, "#d55e00");
  addBall(room.transmitter, "#ffffff");

  const labels = room.labels.map(({text, at}) => {
    const label = document.createElement("span");
    label.textContent = text;
    canvas.parentNode.append(label);
    return {label, point: vectors(at)[0]};
  });
  const place = ({label, point}) => {
    const {x, y, z} = point.clone().project(camera);
    label.hidden = Math.max(Math.abs(x), Math.abs(y), z) > 1;  // outside of the picture, or behind the eye
    const left = (0.5 + 0.5 * x) * canvas.clientWidth - label.offsetWidth / 2;
    const top = (0.5 - 0.5 * y) * canvas.clientHeight + (y < 0 ? 8 : -8 - label.offsetHeight);
    const within = Math.min(Math.max(left, 4), canvas.clientWidth - label.offsetWidth - 4);
    Object.assign(label.style, {left: `${Math.round(within)}px`, top: `${Math.round(top)}px`});
  };

  const renderer = new THREE.WebGLRenderer({canvas, context, antialias: true});
  let eye = {...start}, asked = 0;
  const draw = () => {
    asked = 0;
    eye.tilt = Math.min(1.55, Math.max(-1.55, eye.tilt));
    eye.distance = Math.min(5 * size, Math.max(0.1 * size, eye.distance));
    const {turn, tilt, distance} = eye;
    camera.position.copy(towards(turn, tilt)).multiplyScalar(distance).add(middle);
    camera.lookAt(middle);
    lamp.position.copy(camera.position);
    renderer.render(scene, camera);
    labels.forEach(place);
  };
  const move = (turn, tilt, nearer = 1) => {
    eye = {turn: eye.turn + turn, tilt: eye.tilt + tilt, distance: eye.distance / nearer};
    asked ||= requestAnimationFrame(draw);
  };

  const held = new Map();  // pointers that are down: their places
  const spread = () => {
    const [first, second] = held.values();
    return second ? Math.hypot(first.x - second.x, first.y - second.y) : 0;
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, {x: event.clientX, y: event.clientY});
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId), apart = spread();
    if (!before) return;
    held.set(event.pointerId, {x: event.clientX, y: event.clientY});
    if (apart) move(0, 0, Math.max(1, spread()) / apart);
    else move((before.x - event.clientX) * 0.008, (event.clientY - before.y) * 0.008);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;  // a page that is only scrolled past goes on scrolling
    event.preventDefault();
    move(0, 0, Math.exp(-0.001 * event.deltaY));
  }, {passive: false});
  const keys = {
    ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1],
    "+": [0, 0, 1.15], "=": [0, 0, 1.15], "-": [0, 0, 1 / 1.15],
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Home") eye = {...start};
    else if (!(event.key in keys)) return;
    event.preventDefault();
    move(...(keys[event.key] ?? [0, 0]));
  });
  new ResizeObserver(() => {
    if (!canvas.clientWidth) return;  // hidden, as on paper
    renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    camera.aspect = canvas.clientWidth / canvas.clientHeight;
    camera.updateProjectionMatrix();
    const isFitted = eye.distance === start.distance;
    start.distance = fitted();
    if (isFitted) eye.distance = start.distance;
    draw();
  }).observe(canvas);
})();
