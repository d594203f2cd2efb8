"use strict";
(async () => {
const $ = (id) => document.getElementById(id);
const header = JSON.parse($("replay").textContent);
const TYPES = { f4: Float32Array, i2: Int16Array, u1: Uint8Array, i4: Int32Array };
const packed = Uint8Array.from(atob($("arrays").textContent), (c) => c.charCodeAt(0));
const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
const buffer = await new Response(unpacked).arrayBuffer();

/** Return a stored array with its number of columns: row(i) is a view of one row. */
function array(ref) {
  const columns = ref.shape.slice(1).reduce((a, b) => a * b, 1);
  const data = new TYPES[ref.type](buffer, ref.offset, columns * ref.shape[0]);
  return { data, columns, rows: ref.shape[0], row: (i) => data.subarray(i * columns, (i + 1) * columns) };
}

const episodes = header.episodes.map((given) => {
  const arrays = Object.fromEntries(Object.entries(given.arrays).map(([name, ref]) => [name, array(ref)]));
  return { ...given, ...arrays, last: arrays.pose.rows - 1 };
});
const lastStep = Math.max(...episodes.map((e) => e.last));
/** Is the panel under the view instead of beside it, as in viewer.css? */
const isNarrow = () => matchMedia("(max-width: 820px)").matches;
const now = { step: 0, playing: false, selected: 0, camera: "free", layout: "one", lidar: true };

/** How velocities of water and air are drawn: the length of an arrow grows with the root of the speed [m/s]. */
const ARROW_M = 3;
const FLOWS = {
  current: { light: "#1456b8", dark: "#5ea6ff", scale: (speed) => 0.5 + Math.sqrt(speed), aside: 0, height: 0.3, from: false },
  wind: { light: "#ffffff", dark: "#ffffff", scale: (speed) => 0.4 + 0.35 * Math.sqrt(speed), aside: 1.3, height: 1.6, from: true },
};

// Scene. World frame: x and y in the water plane, z up [m], as in the simulator.
const renderer = new THREE.WebGLRenderer({ canvas: $("view"), antialias: true, preserveDrawingBuffer: true });
renderer.shadowMap.enabled = true;
renderer.toneMapping = THREE.ACESFilmicToneMapping;
const scene = new THREE.Scene();
scene.fog = new THREE.Fog(0);
const [x0, y0, x1, y1] = header.bounds;
const center = new THREE.Vector3((x0 + x1) / 2, (y0 + y1) / 2, 0);
const extent = Math.max(x1 - x0, y1 - y0);

const sky = new THREE.HemisphereLight();
const sun = new THREE.DirectionalLight();
sun.position.set(center.x - 0.5 * extent, center.y - 0.4 * extent, 0.8 * extent);
sun.target.position.copy(center);
sun.castShadow = true;
sun.shadow.mapSize.set(4096, 4096);
sun.shadow.bias = -0.0004;
sun.shadow.normalBias = 0.04;
Object.assign(sun.shadow.camera, { left: -0.7 * extent, right: 0.7 * extent, top: 0.7 * extent, bottom: -0.7 * extent, near: 1, far: 2.5 * extent });
scene.add(sky, sun, sun.target);

const ripples = rippleTexture();
const water = new THREE.Mesh(
  new THREE.PlaneGeometry(8 * extent, 8 * extent),
  new THREE.MeshStandardMaterial({ roughness: 0.32, metalness: 0.05, normalMap: ripples, normalScale: new THREE.Vector2(0.32, 0.32) }),
);
water.position.copy(center);
water.receiveShadow = true;
ripples.repeat.set((8 * extent) / 14, (8 * extent) / 14);
scene.add(water, harborMesh());

/** A tile of small waves as a normal map: a sum of waves whose lengths divide the tile. */
function rippleTexture() {
  const size = 256, data = new Uint8Array(4 * size * size);
  const waves = [[2, 1, 0], [-1, 3, 1], [4, -3, 2], [5, 4, 3], [-7, 2, 4], [3, 8, 5], [9, -6, 6]];
  for (let y = 0; y < size; y++) for (let x = 0; x < size; x++) {
    let dx = 0, dy = 0;
    for (const [kx, ky, phase] of waves) {
      const slope = Math.cos((2 * Math.PI * (kx * x + ky * y)) / size + phase) / Math.sqrt(Math.hypot(kx, ky));
      dx += (slope * kx) / Math.hypot(kx, ky);
      dy += (slope * ky) / Math.hypot(kx, ky);
    }
    const norm = Math.hypot(0.22 * dx, 0.22 * dy, 1);
    data.set([127.5 - (127.5 * 0.22 * dx) / norm, 127.5 - (127.5 * 0.22 * dy) / norm, 127.5 + 127.5 / norm, 255], 4 * (y * size + x));
  }
  const texture = new THREE.DataTexture(data, size, size, THREE.RGBAFormat);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.magFilter = THREE.LinearFilter;
  texture.minFilter = THREE.LinearMipmapLinearFilter;
  texture.generateMipmaps = true;
  texture.anisotropy = 8;
  texture.needsUpdate = true;
  return texture;
}

/** Triangles with flat shading; corners are stored in units of `scale` meters from `origin`. */
function harborMesh() {
  const corners = array(header.harbor.corners), colors = array(header.harbor.color);
  const position = new Float32Array(corners.data.length), shade = new Float32Array(corners.data.length);
  for (let i = 0; i < position.length; i++) position[i] = corners.data[i] * header.harbor.scale + header.harbor.origin[i % 3];
  const palette = header.harbor.palette.map((hex) => new THREE.Color(hex));
  for (let i = 0; i < colors.rows; i++) for (let corner = 0; corner < 3; corner++) palette[colors.data[i]].toArray(shade, 9 * i + 3 * corner);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(shade, 3));
  geometry.computeVertexNormals();
  return withShadow(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.8, side: THREE.DoubleSide })));
}

function withShadow(mesh) {
  mesh.castShadow = mesh.receiveShadow = true;
  return mesh;
}

function outline(points, color, z, opacity = 1) {
  const geometry = new THREE.BufferGeometry().setFromPoints(points.map(([x, y]) => new THREE.Vector3(x, y, z)));
  return new THREE.LineLoop(geometry, new THREE.LineBasicMaterial({ color, transparent: opacity < 1, opacity }));
}

const pointMaterial = new THREE.PointsMaterial({ color: 0xffe14d, sizeAttenuation: false });

/** Everything that belongs to one episode: boat, goals, trail, LiDAR. */
function episodeGroup(episode) {
  const group = new THREE.Group(), boat = new THREE.Group(), masts = new THREE.Group(), { boat: own } = header;
  const triangles = array(own.corners);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(triangles.data, 3));
  geometry.computeVertexNormals();
  const paint = new THREE.MeshStandardMaterial({ color: episode.color, roughness: 0.45, flatShading: true, side: THREE.DoubleSide });
  boat.add(withShadow(new THREE.Mesh(geometry, paint)));
  boat.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), new THREE.LineBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.5 })));
  const dark = new THREE.MeshStandardMaterial({ color: 0x26313a, roughness: 0.5 });
  const drive = new THREE.Group(), propeller = new THREE.Group();
  drive.position.set(own.stern, 0, 0);
  const leg = withShadow(new THREE.Mesh(new THREE.CylinderGeometry(0.05, 0.05, 0.75), dark));
  leg.rotation.x = Math.PI / 2;
  leg.position.set(-0.08, 0, 0.12);
  for (const side of [0, 1, 2]) {
    const blade = new THREE.Mesh(new THREE.PlaneGeometry(0.1, 0.26), new THREE.MeshStandardMaterial({ color: 0xb98b3a, side: THREE.DoubleSide }));
    blade.position.set(0, Math.sin((side * 2 * Math.PI) / 3) * 0.13, Math.cos((side * 2 * Math.PI) / 3) * 0.13);
    blade.rotation.set((-side * 2 * Math.PI) / 3, Math.PI / 3, 0);
    propeller.add(blade);
  }
  propeller.position.set(-0.16, 0, -0.12);
  const thrust = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, 0xffb000, 0.3, 0.2);
  thrust.position.z = 0.75;
  drive.add(leg, propeller, thrust);
  boat.add(drive);
  for (const [x, y, z] of own.lidars) {
    const lidar = withShadow(new THREE.Mesh(new THREE.CylinderGeometry(0.05, 0.05, 0.07), dark));
    lidar.rotation.x = Math.PI / 2;
    lidar.position.set(x, y, z);
    const post = withShadow(new THREE.Mesh(new THREE.CylinderGeometry(0.015, 0.015, Math.max(0.01, z - own.freeboard)), dark));
    post.rotation.x = Math.PI / 2;
    post.position.set(x, y, (z + own.freeboard) / 2);
    masts.add(lidar, post);
  }
  boat.add(masts);

  episode.goals.forEach(([x, y, heading, radius, allowed], index) => {
    const ghost = new THREE.Group(), last = index === episode.goals.length - 1;
    ghost.add(outline(own.outline, episode.color, 0.06), outline(circle(radius), last ? "#2faa90" : "#ebc04e", 0.05, 0.9));
    const fill = new THREE.Mesh(new THREE.CircleGeometry(radius, 40), new THREE.MeshBasicMaterial({ color: last ? "#2faa90" : "#ebc04e", transparent: true, opacity: 0.22, depthWrite: false }));
    fill.position.z = 0.04;
    for (const sign of [-1, 1]) {
      const angle = sign * allowed, reach = 0.75 * own.length;
      ghost.add(outline([[0, 0], [reach * Math.cos(angle), reach * Math.sin(angle)]], last ? "#2faa90" : "#ebc04e", 0.05, 0.9));
    }
    ghost.add(fill);
    ghost.position.set(x, y, 0);
    ghost.rotation.z = heading;
    group.add(ghost);
  });

  const trail = band(episode.pose);
  group.add(new THREE.Mesh(trail, new THREE.MeshBasicMaterial({ color: episode.color, side: THREE.DoubleSide, fog: false, toneMapped: false })));

  const cloud = new THREE.BufferGeometry(), returns = new THREE.Group(), arcs = new THREE.Group();
  if (episode.points) {
    const metric = Float32Array.from(episode.points.data, (cm) => cm / 100);
    cloud.setAttribute("position", new THREE.BufferAttribute(metric, 3));
    returns.add(new THREE.Points(cloud, pointMaterial));
    group.add(returns);
  }
  for (let sector = 0; sector < episode.ranges.columns; sector++) {
    const points = [[0, 0]], [right, left] = episode.sector_edges.slice(sector);
    for (let i = 0; i <= 10; i++) {
      const angle = right + ((left - right) * i) / 10;
      points.push([Math.cos(angle), Math.sin(angle)]);
    }
    arcs.add(outline(points, "#ffffff", 0, 0.75));
  }
  arcs.position.z = 0.12;
  boat.add(arcs);
  group.add(boat);
  const arrows = episode.flow.map((name) => {
    const arrow = flowArrow();
    group.add(arrow);
    return { arrow, name };
  });
  scene.add(group);
  return { group, boat, masts, drive, propeller, thrust, trail, cloud, returns, arcs, arrows };
}

/** A band on the water along poses, six indices for each step: lines are one pixel wide in WebGL. */
function band(poses) {
  const corners = new Float32Array(6 * poses.rows), faces = [], half = 0.06;
  let [acrossX, acrossY] = [0, 0];
  for (let i = 0; i < poses.rows; i++) {
    const [x, y, heading] = poses.row(i), [ax, ay] = poses.row(Math.max(i - 1, 0)), [bx, by] = poses.row(Math.min(i + 1, poses.rows - 1));
    const length = Math.hypot(bx - ax, by - ay);
    const [cx, cy] = length > 1e-6 ? [(ay - by) / length, (bx - ax) / length] : [-Math.sin(heading), Math.cos(heading)];
    const side = cx * acrossX + cy * acrossY < 0 ? -1 : 1; // the band does not twist where the boat changes from ahead to astern
    [acrossX, acrossY] = [side * cx, side * cy];
    corners.set([x + half * acrossX, y + half * acrossY, 0.09, x - half * acrossX, y - half * acrossY, 0.09], 6 * i);
    if (i) faces.push(2 * i - 2, 2 * i - 1, 2 * i, 2 * i, 2 * i - 1, 2 * i + 1);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  geometry.setIndex(faces);
  return geometry;
}

/** An arrow along x, ARROW_M long, that lies flat above the water. */
function flowArrow() {
  const corners = [[0, -0.16], [2, -0.16], [2, 0.16], [0, 0.16], [1.9, -0.5], [3, 0], [1.9, 0.5]];
  const faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]].flat();
  const geometry = new THREE.BufferGeometry().setFromPoints(faces.map((i) => new THREE.Vector3(...corners[i], 0)));
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, transparent: true, opacity: 0.9, fog: false, toneMapped: false }));
}

function circle(radius) {
  return Array.from({ length: 48 }, (_, i) => [radius * Math.cos((i * Math.PI) / 24), radius * Math.sin((i * Math.PI) / 24)]);
}

const groups = episodes.map(episodeGroup);

/** Pose between two steps, with the shorter way around for the heading. */
function poseAt(episode, step) {
  const t = Math.min(step, episode.last), i = Math.min(Math.floor(t), Math.max(episode.last - 1, 0)), f = t - i;
  const a = episode.pose.row(i), b = episode.pose.row(Math.min(i + 1, episode.last));
  const turn = Math.atan2(Math.sin(b[2] - a[2]), Math.cos(b[2] - a[2]));
  return [a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * turn];
}

const rowOf = (episode) => Math.min(Math.floor(now.step + 1e-6), episode.last);

function place(index) {
  const episode = episodes[index], parts = groups[index], i = rowOf(episode);
  const [x, y, heading] = poseAt(episode, now.step), [force, rudder] = episode.command.row(i);
  parts.boat.position.set(x, y, 0);
  parts.boat.rotation.z = heading;
  parts.drive.rotation.z = -rudder;
  const share = force / header.limits.propeller_n;
  parts.propeller.rotation.x = now.step * header.period_s * 14 * share;
  parts.thrust.visible = Math.abs(share) > 0.01;
  parts.thrust.setDirection(new THREE.Vector3(Math.sign(share) || 1, 0, 0));
  parts.thrust.setLength(0.3 + 1.9 * Math.abs(share), 0.3, 0.2);
  parts.trail.setDrawRange(0, 6 * i);
  parts.returns.visible = parts.arcs.visible = now.lidar;
  if (episode.points) {
    let scan = 0;
    while (scan + 1 < episode.scans.rows && episode.scans.row(scan + 1)[0] <= i) scan++;
    const [step, first] = episode.scans.row(scan), end = scan + 1 < episode.scans.rows ? episode.scans.row(scan + 1)[1] : episode.points.rows;
    const seen = episode.pose.row(step);
    parts.returns.position.set(seen[0], seen[1], 0);
    parts.returns.rotation.z = seen[2];
    parts.cloud.setDrawRange(first, end - first);
  }
  parts.arcs.children.forEach((arc, sector) => {
    const range = episode.ranges.row(i)[sector];
    arc.visible = range < episode.range_m;
    arc.scale.set(range, range, 1);
    arc.material.color.set(tone(range));
  });
  for (const { arrow, name } of parts.arrows) {
    const [vx, vy] = episode[name].row(i), speed = Math.hypot(vx, vy);
    arrow.visible = speed > 1e-3;
    if (!arrow.visible) continue;
    // The tip ends beside the boat; the wind is higher and to the side, so that it does not cover the current.
    const { scale, aside, height } = FLOWS[name], length = scale(speed), [cx, cy] = [vx / speed, vy / speed];
    const away = 2.6 + ARROW_M * length;
    arrow.position.set(x - away * cx - aside * cy, y - away * cy + aside * cx, height);
    arrow.rotation.z = Math.atan2(vy, vx);
    arrow.scale.x = length;
  }
}

function tone(range) {
  return range < 1 ? "#f0525c" : range < 3 ? "#f2b33d" : "#7fd6c2";
}

// Cameras: one for each tile; "free" is shared, so that all tiles are seen from the same side.
const CAMERAS = { free: "Free", above: "Above", astern: "Astern", bridge: "Bridge" };
const free = new THREE.PerspectiveCamera(38, 1, 0.1, 20 * extent);
free.up.set(0, 0, 1);
const follow = new THREE.PerspectiveCamera(50, 1, 0.05, 20 * extent);
const controls = new THREE.OrbitControls(free, $("view"));
controls.maxPolarAngle = 1.53;
controls.minDistance = 3;
controls.maxDistance = 4 * extent;
controls.zoomToCursor = true;
resetFreeCamera();

function resetFreeCamera() {
  const path = episodes.flatMap((e) => [e.pose.row(0), e.pose.row(e.last), ...e.goals]);
  const [a, b] = [0, 1].map((axis) => path.map((pose) => pose[axis]));
  const middle = new THREE.Vector3((Math.min(...a) + Math.max(...a)) / 2, (Math.min(...b) + Math.max(...b)) / 2, 0);
  const span = Math.max(22, Math.max(...a) - Math.min(...a), Math.max(...b) - Math.min(...b)) * Math.max(1, innerHeight / innerWidth);
  controls.target.copy(middle);
  free.position.set(middle.x - 0.75 * span, middle.y - 1.15 * span, 0.85 * span);
  controls.update();
}

function cameraFor(index, aspect) {
  const [x, y, heading] = poseAt(episodes[index], now.step), c = Math.cos(heading), s = Math.sin(heading);
  const camera = now.camera === "free" ? free : follow;
  camera.aspect = aspect;
  if (now.camera === "above") {
    camera.up.set(0, 1, 0);
    camera.fov = 36;
    camera.position.set(x, y, aspect < 0.8 ? 46 : 34);
    camera.lookAt(x, y, 0);
  } else if (now.camera === "astern") {
    camera.up.set(0, 0, 1);
    camera.fov = 50;
    camera.position.set(x - 9 * c, y - 9 * s, 4.2);
    camera.lookAt(x + 3 * c, y + 3 * s, 0);
  } else if (now.camera === "bridge") {
    camera.up.set(0, 0, 1);
    camera.fov = 75;
    camera.position.set(x - 0.3 * c, y - 0.3 * s, 1.5);
    const ahead = episodes[index].phase.data[rowOf(episodes[index])] === 0 && episodes[index].goals.length > 1 ? 8 : -8;
    camera.lookAt(x + ahead * c, y + ahead * s, -0.4);
  }
  return camera;
}

/** What header, controls and panel leave free, from the left edge of the window [CSS pixels]. */
function freeArea() {
  const edges = (tag) => document.querySelector(tag).getBoundingClientRect();
  const open = !document.body.classList.contains("wide"), narrow = isNarrow();
  return {
    top: edges("header").bottom + 12,
    right: open && !narrow ? edges("aside").left - 12 : innerWidth,
    bottom: edges(open && narrow ? "aside" : "footer").top - 12,
  };
}

/** Rectangles of the tiles in CSS pixels: [left, top, width, height, episode]. */
function tiles() {
  if (now.layout !== "side by side" || episodes.length < 2) return [[0, 0, innerWidth, innerHeight, now.selected]];
  const { top, right, bottom } = freeArea();
  const columns = Math.max(1, Math.round(Math.sqrt((episodes.length * right) / (bottom - top) / 1.3))), rows = Math.ceil(episodes.length / columns);
  const width = right / columns, height = (bottom - top) / rows;
  return episodes.map((_, i) => [(i % columns) * width, top + Math.floor(i / columns) * height, width, height, i]);
}

function draw() {
  episodes.forEach((_, index) => place(index));
  const layout = tiles(), { top: above, right, bottom: below } = freeArea();
  renderer.setScissorTest(false);
  if (layout.length > 1) renderer.clear();
  renderer.setScissorTest(layout.length > 1);
  for (const [left, top, width, height, index] of layout) {
    groups.forEach((parts, i) => {
      parts.group.visible = i === index || (layout.length === 1 && now.layout === "together");
      parts.masts.visible = i !== index || now.camera !== "bridge"; // they would stand in the middle of the picture
      if (now.layout === "together" && i !== now.selected) parts.returns.visible = parts.arcs.visible = false;
    });
    const bottom = innerHeight - top - height;
    renderer.setViewport(left, bottom, width, height);
    renderer.setScissor(left, bottom, width, height);
    const camera = cameraFor(index, width / height);
    // The center of the picture is that of the free area; a boat that is followed fits into it also in a narrow window.
    const tall = camera === follow && isNarrow() ? Math.max(below - above, height / 4) : height;
    if (layout.length > 1) camera.clearViewOffset();
    else camera.setViewOffset(width, tall, (width - right) / 2, (tall - above - below) / 2, width, height);
    pointMaterial.size = Math.min(2.6, 0.0045 * height); // of a small tile they would cover the harbor
    // Haze over what is far away, not over a harbor that is seen from afar, as a narrow screen needs it.
    scene.fog.near = extent + (camera === free ? camera.position.distanceTo(controls.target) : 0);
    scene.fog.far = scene.fog.near + 3 * extent;
    renderer.render(scene, camera);
  }
}

// Panel
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Return a drawing context scaled to CSS pixels, cleared. */
function pencil(id) {
  const canvas = $(id), width = canvas.clientWidth || 270, height = Number(canvas.dataset.height), density = devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * density)) {
    canvas.width = Math.round(width * density);
    canvas.height = Math.round(height * density);
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(density, 0, 0, density, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "middle";
  return { context, width, height };
}

const degrees = (radians) => (radians * 180) / Math.PI;
/** A direction in degrees from 0 to 360, rounded before it is wrapped, so that 359.97 is 0.0. */
const direction = (radians, digits) => fixed((Number(degrees(radians).toFixed(digits)) % 360 + 360) % 360, digits);
const fixed = (value, digits) => (Object.is(+value.toFixed(digits), -0) ? 0 : value).toFixed(digits).replace("-", "\u2212");

function drawState(episode, i) {
  const [x, y, heading] = episode.pose.row(i), [u, v, r] = episode.velocity.row(i), ended = i === episode.last;
  const rows = [
    ["Policy", episode.policy],
    ["Position", `${fixed(x, 2)}, ${fixed(y, 2)} m`],
    ["Heading", `${direction(heading, 1)}°`],
    ["Surge, sway", `${fixed(u, 2)}, ${fixed(v, 2)} m/s`],
    ["Yaw rate", `${fixed(degrees(r), 1)}°/s`],
    ["Goal", episode.goals.length > 1 && episode.phase.data[i] === 0 ? "intermediate pose" : "berth"],
    ["Distance", `${fixed(episode.distance_m.data[i], 2)} m`],
    ["Heading error", `${fixed(degrees(episode.heading_error_rad.data[i]), 1)}°`],
    ...episode.flow.map((name) => {
      const [vx, vy] = episode[name].row(i), { from } = FLOWS[name], toward = Math.atan2(vy, vx) + (from ? Math.PI : 0);
      return [name[0].toUpperCase() + name.slice(1), `${fixed(Math.hypot(vx, vy), 2)} m/s ${from ? "from" : "to"} ${direction(toward, 0)}°`];
    }),
    ["Outcome", ended ? episode.text : "under way", ended ? episode.outcome : ""],
  ];
  $("state").replaceChildren(...rows.flatMap(([name, value, style]) => {
    const [term, description] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = name;
    description.textContent = value;
    if (style) description.className = style;
    return [term, description];
  }));
}

function drawCommand(episode, i) {
  const { context: c, width } = pencil("command"), [force, rudder] = episode.command.row(i), angle = -rudder;
  const middle = width * 0.28, limit = header.limits.propeller_n, half = width * 0.24;
  c.fillStyle = ink("chip");
  c.fillRect(middle - half, 30, 2 * half, 16);
  c.fillStyle = force < 0 ? ink("warn") : ink("accent");
  c.fillRect(Math.min(middle, middle + (half * force) / limit), 30, Math.abs((half * force) / limit), 16);
  c.fillStyle = ink("soft");
  c.fillRect(middle - 0.5, 26, 1, 24);
  c.textAlign = "left";
  c.fillText("Propeller", middle - half, 14);
  c.fillText("astern", middle - half, 60);
  c.textAlign = "right";
  c.fillText("ahead", middle + half, 60);
  c.fillStyle = ink("ink");
  c.font = "600 13px system-ui, sans-serif";
  c.fillText(`${fixed(force, 0)} N`, middle + half, 14);
  const pivot = width * 0.78, largest = (header.limits.rudder_deg * Math.PI) / 180;
  c.strokeStyle = ink("rule");
  c.lineWidth = 2;
  c.beginPath();
  c.arc(pivot, 34, 52, Math.PI / 2 - largest, Math.PI / 2 + largest);
  c.stroke();
  c.strokeStyle = ink("accent");
  c.lineWidth = 5;
  c.lineCap = "round";
  c.beginPath();
  c.moveTo(pivot, 34);
  c.lineTo(pivot + 46 * Math.sin(angle), 34 + 46 * Math.cos(angle));
  c.stroke();
  c.fillStyle = ink("soft");
  c.font = "11px system-ui, sans-serif";
  c.textAlign = "left";
  c.fillText("Rudder", pivot - 58, 14);
  c.fillStyle = ink("ink");
  c.font = "600 13px system-ui, sans-serif";
  c.textAlign = "right";
  c.fillText(`${fixed(degrees(rudder), 0)}°`, pivot + 58, 14);
}

/** Sectors from above, bow up; the radius grows with the square root of the range. */
function drawSectors(episode, i) {
  const { context: c, width, height } = pencil("sectors"), ranges = episode.ranges.row(i);
  const x = width / 2, y = height / 2, reach = height / 2 - 12, scale = (range) => reach * Math.sqrt(Math.min(range, 30) / 30);
  c.strokeStyle = ink("rule");
  c.fillStyle = ink("soft");
  c.textAlign = "left";
  for (const ring of [1, 5, 15, 30]) {
    c.beginPath();
    c.arc(x, y, scale(ring), 0, 2 * Math.PI);
    c.stroke();
  }
  for (let sector = 0; sector < ranges.length; sector++) {
    // Body angle a (counterclockwise from the bow) is drawn at -90° - a.
    const [to, from] = episode.sector_edges.slice(sector, sector + 2).map((angle) => -Math.PI / 2 - angle);
    const known = ranges[sector] < episode.range_m;
    c.globalAlpha = known ? 0.8 : 0.15;
    c.fillStyle = known ? tone(ranges[sector]) : ink("soft");
    c.beginPath();
    c.moveTo(x, y);
    c.arc(x, y, known ? scale(ranges[sector]) : reach, from, to);
    c.fill();
    c.globalAlpha = 1;
    c.fillStyle = ink("ink");
    c.textAlign = "center";
    const angle = (from + to) / 2, away = reach + (Math.abs(Math.cos(angle)) > 0.6 ? 22 : 4);
    c.fillText(known ? fixed(ranges[sector], 2) : "–", x + away * Math.cos(angle), y + away * Math.sin(angle) * 0.97);
  }
  c.save();
  c.translate(x, y);
  c.fillStyle = episode.color;
  c.beginPath();
  const size = 13 / header.boat.length;
  header.boat.outline.forEach(([bx, by], k) => (k ? c.lineTo(-by * size, -bx * size) : c.moveTo(-by * size, -bx * size)));
  c.fill();
  c.restore();
}

function drawReward(episode, i) {
  const names = header.terms, step = episode.terms.row(i), total = episode.term_sums.row(i);
  // A bar is full at what few steps exceed: beside the reward of the berth all others would be too short to see.
  const sizes = Array.from({ length: episode.last + 1 }, (_, row) => Math.max(...episode.terms.row(row).map(Math.abs))).sort((a, b) => a - b);
  const largest = Math.max(1e-9, sizes[Math.floor(0.95 * episode.last)]);
  const cells = [...names.map((name, k) => [name, step[k], total[k]]), ["total", episode.reward.data[i], episode.returns.data[i]]];
  $("reward").replaceChildren(...cells.flatMap(([name, value, sum]) => {
    const label = document.createElement("span"), bar = document.createElement("u"), a = document.createElement("em"), b = document.createElement("em");
    const share = 50 * Math.min(1, Math.sqrt(Math.abs(value) / largest));
    label.textContent = name.replaceAll("_", " ");
    label.title = name;
    bar.style.setProperty("--from", `${value < 0 ? 50 - share : 50}%`);
    bar.style.setProperty("--width", `${share}%`);
    bar.style.setProperty("--tone", value < 0 ? ink("bad") : ink("good"));
    a.textContent = fixed(value, 1);
    b.textContent = fixed(sum, 0);
    return [label, bar, a, b];
  }));
  const { context: c, width, height } = pencil("return"), low = Math.min(0, ...episode.returns.data), high = Math.max(1, ...episode.returns.data);
  const px = (row) => (row / Math.max(1, episode.last)) * (width - 2) + 1, py = (value) => height - 12 - ((value - low) / (high - low)) * (height - 22);
  c.strokeStyle = ink("rule");
  c.beginPath();
  c.moveTo(0, py(0));
  c.lineTo(width, py(0));
  c.stroke();
  c.strokeStyle = ink("accent");
  c.lineWidth = 1.6;
  c.beginPath();
  episode.returns.data.forEach((value, row) => (row ? c.lineTo(px(row), py(value)) : c.moveTo(px(row), py(value))));
  c.stroke();
  c.fillStyle = ink("accent");
  c.beginPath();
  c.arc(px(i), py(episode.returns.data[i]), 4, 0, 2 * Math.PI);
  c.fill();
  c.fillStyle = ink("soft");
  c.fillText("return", 1, height - 5);
}

/** Forces by rows, rudder angles by columns; the frame marks the largest value. */
function drawQ(episode, i) {
  $("q-section").hidden = !(episode.q && episode.grid);
  if (!episode.q || !episode.grid) return;
  const { propeller_n: forces, rudder_deg: angles } = episode.grid, values = episode.q.row(i);
  const { context: c, width, height } = pencil("q"), left = 34, top = 2, w = (width - left) / angles.length, h = (height - top - 16) / forces.length;
  const low = Math.min(...values), high = Math.max(...values), best = values.indexOf(high);
  const [from, to] = [ink("low"), ink("high")].map((hex) => new THREE.Color(hex));
  c.textAlign = "right";
  forces.forEach((force, row) => {
    const y = top + (forces.length - 1 - row) * h;
    c.fillStyle = ink("soft");
    if (row % 2 === 1 || forces.length < 8) c.fillText(`${fixed(force, 0)}`, left - 5, y + h / 2);
    angles.forEach((_, column) => {
      const share = (values[row * angles.length + column] - low) / (high - low || 1);
      c.fillStyle = `#${from.clone().lerp(to, share ** 3).getHexString()}`;
      c.fillRect(left + column * w + 0.5, y + 0.5, w - 1, h - 1);
    });
  });
  c.textAlign = "center";
  c.fillStyle = ink("soft");
  angles.forEach((angle, column) => c.fillText(`${fixed(angle, 0)}°`, left + (column + 0.5) * w, height - 7));
  c.strokeStyle = ink("warn");
  c.lineWidth = 2;
  c.strokeRect(left + (best % angles.length) * w + 1, top + (forces.length - 1 - Math.floor(best / angles.length)) * h + 1, w - 2, h - 2);
  $("q-caption").textContent = `${fixed(low, 0)} to ${fixed(high, 0)}`;
}

function drawTiles() {
  const layout = tiles();
  $("tiles").replaceChildren(...(layout.length < 2 ? [] : layout.flatMap(([left, top, width, height, index]) => {
    const label = document.createElement("span"), edge = document.createElement("i"), side = document.createElement("i");
    label.textContent = episodes[index].label;
    Object.assign(label.style, { left: `${left}px`, top: `${top + height - 8}px`, maxWidth: `${width - 16}px`, borderLeft: `4px solid ${episodes[index].color}` });
    Object.assign(edge.style, { left: `${left}px`, top: `${top + height - 1}px`, width: `${width}px`, height: "2px" });
    Object.assign(side.style, { left: `${left + width - 1}px`, top: `${top}px`, width: "2px", height: `${height}px` });
    return [label, edge, side];
  })));
}

function update() {
  const episode = episodes[now.selected], i = rowOf(episode);
  $("time").value = String(Math.round(now.step));
  $("clock").textContent = `${fixed(Math.min(now.step, episode.last) * header.period_s, 1)} of ${fixed(episode.last * header.period_s, 1)} s`;
  drawState(episode, i);
  drawCommand(episode, i);
  drawSectors(episode, i);
  drawReward(episode, i);
  drawQ(episode, i);
  draw();
}

// Controls
function seek(step) {
  now.step = Math.max(0, Math.min(lastStep, step));
  update();
}

function play(on) {
  now.playing = on;
  if (on && now.step >= lastStep) now.step = 0;
  $("play").classList.toggle("playing", on);
  $("play").setAttribute("aria-label", on ? "Pause" : "Play");
}

function choose(group, key, value) {
  now[key] = value;
  for (const button of $(group).children) button.setAttribute("aria-checked", String(button.dataset.value === String(value)));
  controls.enabled = now.camera === "free";
  drawTiles();
  update();
}

function radio(group, key, entries) {
  $(group).replaceChildren(...entries.map(([value, text, title]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("role", "radio");
    button.dataset.value = String(value);
    button.append(...[text].flat());
    if (title) button.title = title;
    button.addEventListener("click", () => choose(group, key, value));
    return button;
  }));
  if (entries.length < 2) $(group).replaceChildren();
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  const dark = name === "dark";
  const air = new THREE.Color(dark ? "#0d1822" : "#c4dbe6");
  scene.background = scene.fog.color = air;
  renderer.setClearColor(air); // around the tiles
  water.material.color.set(dark ? "#2b5f80" : "#4f93ad");
  sky.color.set(dark ? "#5a7fa6" : "#ffffff");
  sky.groundColor.set(dark ? "#33495c" : "#7fa3b4");
  sky.intensity = 1.5;
  sun.color.set(dark ? "#bcd2ff" : "#fff3dc");
  sun.intensity = dark ? 1.7 : 2.6;
  for (const { arrow, name: flow } of groups.flatMap((group) => group.arrows)) arrow.material.color.set(FLOWS[flow][name]);
  update();
}

function resize() {
  const { top } = document.querySelector("footer").getBoundingClientRect();
  document.body.style.setProperty("--controls", `${innerHeight - top}px`);
  renderer.setPixelRatio(Math.min(2, devicePixelRatio || 1));
  renderer.setSize(innerWidth, innerHeight, false);
  drawTiles();
  update();
}

const toggles = {
  lidar: () => { now.lidar = !now.lidar; return now.lidar; },
  "panel-toggle": () => !document.body.classList.toggle("wide"),
};
for (const [id, change] of Object.entries(toggles)) $(id).addEventListener("click", () => { $(id).setAttribute("aria-pressed", String(change())); resize(); });
$("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
$("play").addEventListener("click", () => play(!now.playing));
$("time").max = String(lastStep);
$("time").addEventListener("input", () => { play(false); seek(Number($("time").value)); });
controls.addEventListener("change", draw);
addEventListener("resize", resize);
const KEYS = {
  " ": () => play(!now.playing),
  ArrowRight: (e) => seek(Math.round(now.step) + (e.shiftKey ? 10 : 1)),
  ArrowLeft: (e) => seek(Math.round(now.step) - (e.shiftKey ? 10 : 1)),
  Home: () => seek(0),
  End: () => seek(lastStep),
  n: () => choose("episodes", "selected", (now.selected + 1) % episodes.length),
  p: () => choose("episodes", "selected", (now.selected + episodes.length - 1) % episodes.length),
  l: () => $("lidar").click(),
  i: () => $("panel-toggle").click(),
  t: () => $("theme").click(),
};
Object.keys(CAMERAS).forEach((name, index) => { KEYS[index + 1] = () => choose("cameras", "camera", name); });
// A button that was clicked would keep the space bar from the player; one reached by the Tab key keeps it.
addEventListener("click", ({ detail, target }) => { if (detail) target.closest?.("button")?.blur(); });
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, action = KEYS[key];
  if (!action || (key === " " && event.target instanceof HTMLButtonElement)) return;
  event.preventDefault();
  if (key.startsWith("Arrow") || key === "Home" || key === "End") play(false);
  action(event);
});

radio("episodes", "selected", episodes.map((episode, index) => {
  const dot = document.createElement("b");
  dot.style.background = episode.color;
  return [index, [dot, `${episode.label} · ${episode.outcome || "start"}`], episode.text];
}));
radio("cameras", "camera", Object.entries(CAMERAS).map(([value, text], index) => [value, text, `Camera: ${text.toLowerCase()} (${index + 1})`]));
radio("layouts", "layout", episodes.length < 2 ? [] : [["one", "One"], ["together", "Together"], ["side by side", "Side by side"]]);
for (const [group, key] of [["cameras", "camera"], ["episodes", "selected"], ["layouts", "layout"]]) choose(group, key, now[key]);
if (isNarrow()) $("panel-toggle").click();
resize();
theme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");

let before = performance.now();
function frame(time) {
  const elapsed = Math.min(0.1, (time - before) / 1000);
  before = time;
  if (now.playing) {
    now.step = Math.min(lastStep, now.step + (elapsed * Number($("speed").value)) / header.period_s);
    ripples.offset.set(ripples.offset.x + 0.012 * elapsed, ripples.offset.y + 0.007 * elapsed);
    if (now.step >= lastStep) play(false);
    update();
  }
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);

/** For scripts and tests: go to a step, and read where the boat is drawn. */
window.replay = { seek, choose, theme, pose: () => { const { position, rotation } = groups[now.selected].boat; return [position.x, position.y, rotation.z]; }, screen: (x, y) => new THREE.Vector3(x, y, 0).project(free).toArray(), now, episodes: episodes.length };
document.documentElement.dataset.ready = "true";
})();
