// Draws what /feed sends: a list with a message per wearer, see monitor/web.py.
const RECENT_S = 30;
const [TIME, EAST, NORTH, , SPEED, STANCE, N_EFF, , DOUBTFUL] = [0, 1, 2, 3, 4, 5, 6, 7, 8];
const element = (id) => document.getElementById(id);
const wearers = new Map();
const view = { east: 0, north: 0, scale: 20, follow: true };

function take(messages) {
  for (const message of messages) {
    let wearer = wearers.get(message.name);
    if (!wearer) {
      wearer = { way: [], recent: [], card: card(message.colour) };
      wearers.set(message.name, wearer);
    }
    if (message.reset) wearer.way = [], wearer.recent = [];
    wearer.way.push(...message.way);
    wearer.recent.push(...message.recent);
    const last = wearer.recent.at(-1);
    if (last) wearer.recent = wearer.recent.filter((p) => last[TIME] - p[TIME] <= RECENT_S);
    wearer.state = message;
    describe(wearer);
  }
  window.requestAnimationFrame(draw);
}

function card(colour) {
  const article = document.createElement("article");
  article.style.borderLeftColor = colour;
  element("wearers").append(article);
  return article;
}

// Names and logs come from a wire: text only, never markup.
function line(text, style) {
  const p = document.createElement("p");
  p.textContent = text;
  if (style) p.className = style;
  return p;
}

function describe({ card, state }) {
  const title = document.createElement("h2");
  title.textContent = state.name;
  const lines = [title];
  if (state.unplugged) lines.push(line("unplugged: waiting for it", "bad"));
  else if (state.age === null) lines.push(line("waiting for the board"));
  else if (state.stale) lines.push(line(`no data for ${state.age.toFixed(0)} s`, "bad"));
  const recording = state.recording ? ", recording" : "";
  lines.push(line(`${state.mode}${recording}`));
  if (state.position) {
    const [east, north, up] = state.position.map((v) => v.toFixed(2));
    lines.push(line(`E ${east}  N ${north}  U ${up} m   ${state.speed.toFixed(2)} m/s   ${state.heading.toFixed(0)}°`));
    lines.push(line(`${state.steps} steps, ${state.distance.toFixed(1)} m, spread ${state.spread.toFixed(2)} m, N_eff ${state.n_eff.toFixed(0)}, M ${state.threshold.toFixed(2)}`));
  }
  if (state.lost_frames || state.damaged_frames)
    lines.push(line(`${state.lost_frames} frames lost, ${state.damaged_frames} damaged`));
  for (const text of [...state.warnings, ...(state.trouble ? [state.trouble] : [])]) lines.push(line(text, "bad"));
  for (const text of state.log.slice(-3)) lines.push(line(text, "log"));
  card.replaceChildren(...lines);
  card.className = state.stale || state.unplugged ? "stale" : "";
}

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const style = getComputedStyle(document.documentElement);
  return { context, width, height, front: style.getPropertyValue("--front"), faint: style.getPropertyValue("--faint") };
}

function follow(width, height) {
  const points = [...wearers.values()].flatMap((w) => [...w.way, ...w.recent.slice(-1)]);
  if (!points.length) return;
  const span = (axis) => points.reduce(([low, high], p) => [Math.min(low, p[axis]), Math.max(high, p[axis])], [Infinity, -Infinity]);
  const [west, east] = span(EAST), [south, north] = span(NORTH);
  view.east = (west + east) / 2;
  view.north = (south + north) / 2;
  view.scale = Math.min(width / Math.max(east - west, 8), height / Math.max(north - south, 8)) / 1.25;
}

function drawTrack() {
  const { context, width, height, front, faint } = prepared(element("track"));
  if (view.follow) follow(width, height);
  const x = (east) => width / 2 + (east - view.east) * view.scale;
  const y = (north) => height / 2 - (north - view.north) * view.scale;
  const metres = 10 ** Math.ceil(Math.log10(60 / view.scale));
  const step = metres / (metres * view.scale > 300 ? 5 : metres * view.scale > 150 ? 2 : 1);
  context.strokeStyle = faint;
  context.lineWidth = 1;
  context.beginPath();
  for (let e = Math.ceil((view.east - width / 2 / view.scale) / step) * step; x(e) < width; e += step)
    context.moveTo(x(e), 0), context.lineTo(x(e), height);
  for (let n = Math.ceil((view.north - height / 2 / view.scale) / step) * step; y(n) > 0; n += step)
    context.moveTo(0, y(n)), context.lineTo(width, y(n));
  context.stroke();
  context.fillStyle = front;
  context.font = "13px system-ui, sans-serif";
  context.fillText(`${+step.toPrecision(2)} m`, 10, height - 14);
  context.fillText("N ↑", width - 34, 20);
  context.fillRect(10, height - 10, step * view.scale, 2);
  for (const { way, recent, state } of wearers.values()) {
    const last = recent.at(-1) ?? way.at(-1);
    if (!last) continue;
    context.strokeStyle = context.fillStyle = state.colour;
    context.lineWidth = 2;
    context.beginPath();
    for (const [i, point] of [...way, last].entries())
      i ? context.lineTo(x(point[EAST]), y(point[NORTH])) : context.moveTo(x(point[EAST]), y(point[NORTH]));
    context.stroke();
    context.globalAlpha = state.stale || last[DOUBTFUL] ? 0.4 : 1;
    context.beginPath();
    context.arc(x(last[EAST]), y(last[NORTH]), 7, 0, 2 * Math.PI);
    context.fill();
    const heading = state.heading * Math.PI / 180;
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(x(last[EAST]), y(last[NORTH]));
    context.lineTo(x(last[EAST]) + 18 * Math.sin(heading), y(last[NORTH]) - 18 * Math.cos(heading));
    context.stroke();
    context.globalAlpha = 1;
    context.fillText(state.name, x(last[EAST]) + 11, y(last[NORTH]) - 11);
  }
}

function drawStrip(id, top, value) {
  const { context, width, height, front } = prepared(element(id));
  context.fillStyle = front;
  context.font = "11px system-ui, sans-serif";
  if (top) context.fillText(`${+top.toPrecision(2)}`, 3, 11);
  let place = 0;
  for (const { recent, state } of wearers.values()) {
    const now = recent.at(-1)?.[TIME];
    context.strokeStyle = state.colour;
    context.lineWidth = top ? 1.5 : 8;
    context.beginPath();
    let drawing = false;
    for (const point of recent) {
      const v = value(point);
      const x = width * (1 - (now - point[TIME]) / RECENT_S);
      const y = top ? height * (1 - v / top) : height * (place + 0.5) / wearers.size;
      if (v === null) drawing = false;
      else if (drawing) context.lineTo(x, y);
      else context.moveTo(x, y), drawing = true;
    }
    context.stroke();
    place += 1;
  }
}

function draw() {
  drawTrack();
  const speeds = [...wearers.values()].flatMap((w) => w.recent.map((p) => p[SPEED]));
  drawStrip("speed", Math.max(2, ...speeds) * 1.1, (p) => p[SPEED]);
  drawStrip("stance", 0, (p) => (p[STANCE] ? 1 : null));
  drawStrip("confidence", 105, (p) => (p[STANCE] ? p[N_EFF] : null));
}

function setFollow(on) {
  view.follow = on;
  element("follow").setAttribute("aria-pressed", String(on));
  draw();
}

function zoom(factor) {
  view.scale *= factor;
  setFollow(false);
}

const track = element("track");
let held = null;
track.addEventListener("pointerdown", (event) => {
  held = [event.clientX, event.clientY];
  track.setPointerCapture(event.pointerId);
});
track.addEventListener("pointermove", (event) => {
  if (!held) return;
  view.east -= (event.clientX - held[0]) / view.scale;
  view.north += (event.clientY - held[1]) / view.scale;
  held = [event.clientX, event.clientY];
  setFollow(false);
});
track.addEventListener("pointerup", () => (held = null));
track.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
}, { passive: false });
track.addEventListener("keydown", ({ key }) => {
  const step = 60 / view.scale;
  const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
  if (key in moves) {
    view.east += moves[key][0];
    view.north += moves[key][1];
    setFollow(false);
  }
});
document.addEventListener("keydown", ({ key }) => {
  if (key === "+") zoom(1.2);
  else if (key === "-") zoom(1 / 1.2);
  else if (key === "f") setFollow(!view.follow);
});
element("follow").addEventListener("click", () => setFollow(!view.follow));
element("closer").addEventListener("click", () => zoom(1.2));
element("farther").addEventListener("click", () => zoom(1 / 1.2));
window.addEventListener("resize", draw);

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/feed`);
  const told = element("connection");
  socket.onmessage = ({ data }) => {
    told.textContent = "connected";
    told.className = "";
    take(JSON.parse(data));
  };
  socket.onclose = () => {
    told.textContent = "the connection to solenav is lost: trying again";
    told.className = "lost";
    for (const { card } of wearers.values()) card.classList.add("stale");
    setTimeout(connect, 1000);
  };
}
connect();
