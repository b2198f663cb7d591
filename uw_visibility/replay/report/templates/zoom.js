// Zoom in time: all series of the page show the same interval.
const SHORTEST = 1;  // s
const STEPS = [
  0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200];
const DAY = 86400;
const PIXELS_PER_POINT = 96 / 72;
const HALF_LABEL = 26;

function element(name, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

const clock = (time, first, last) => new Date(1000 * time).toISOString().slice(first, last);

function days([start, end]) {
  const [first, last] = [start, end].map((time) => clock(time, 0, 10));
  return first === last ? first : `${first} to ${last}`;
}

// Drawing of one series. Elements clipped to the axes are data, and get a separate view.
class Plot {
  constructor(svg, whole) {
    const area = svg.querySelector("clipPath rect");
    const number = (name) => Number(area.getAttribute(name));
    this.svg = svg;
    this.whole = whole;
    this.axis = svg.querySelector('[id*="matplotlib.axis_1"]');
    [this.x, this.y, this.width, this.height] = ["x", "y", "width", "height"].map(number);
    const data = [...svg.querySelectorAll("[clip-path]")].filter(
      (one) => !one.closest('[id*="matplotlib.axis"]'));
    this.view = element("svg", {
      x: this.x, y: this.y, width: this.width, height: this.height, preserveAspectRatio: "none",
      class: "data",
    });
    this.points = data.filter((one) => one.parentNode.id.includes("line2d")).flatMap(
      (one) => [...one.querySelectorAll("use")]);
    svg.querySelector('[id*="matplotlib.axis_2"]').after(this.view);
    for (const one of [...data, ...svg.querySelectorAll(".over")]) {
      one.style.strokeWidth = `${PIXELS_PER_POINT * parseFloat(getComputedStyle(one).strokeWidth)}px`;
      one.removeAttribute("clip-path");
      this.view.append(one);
    }
    this.ticks = element("g", { class: "ticks" });
    this.axis.before(this.ticks);
  }

  time(event) {
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(
      this.svg.getScreenCTM().inverse());
    const share = Math.min(Math.max((place.x - this.x) / this.width, 0), 1);
    return this.shown[0] + share * (this.shown[1] - this.shown[0]);
  }

  place(time) {
    return this.x + (time - this.shown[0]) / (this.shown[1] - this.shown[0]) * this.width;
  }

  show(shown) {
    const scale = (this.whole[1] - this.whole[0]) / (shown[1] - shown[0]);
    const skipped = (shown[0] - this.whole[0]) / (this.whole[1] - this.whole[0]);
    this.shown = shown;
    this.view.setAttribute("viewBox",
      [this.x + skipped * this.width, this.y, this.width / scale, this.height].join(" "));
    for (const point of this.points) {
      const x = point.getAttribute("x");
      point.setAttribute("transform", `translate(${x} 0) scale(${1 / scale} 1) translate(${-x} 0)`);
    }
    this.axis.style.display = scale > 1 ? "none" : "";
    this.ticks.replaceChildren(...(scale > 1 ? this.label() : []));
  }

  label() {
    const [start, end] = this.shown;
    const most = this.width > 400 ? 8 : 4;
    const least = (end - start) / most;
    const step = STEPS.find((one) => one >= least) ?? DAY * Math.ceil(least / DAY);
    const [first, last] = (
      step < 1 ? [11, 21] : step < 60 ? [11, 19] : step < DAY ? [11, 16] : [5, 10]);
    const below = this.y + this.height;
    const made = [];
    for (let count = Math.ceil(start / step); count * step <= end; count += 1) {
      const time = count * step;
      const x = this.place(time);
      made.push(element("path", { d: `M${x} ${this.y}V${below + 3.5}` }));
      // No label where the edge of the drawing would cut it off.
      if (x + HALF_LABEL < this.svg.viewBox.baseVal.width) {
        made.push(element("text", { x, y: below + 14 }, clock(time, first, last)));
      }
    }
    made.push(element("text", { x: this.x + this.width / 2, y: below + 27 },
      `time (UTC), ${days(this.shown)}`));
    return made;
  }
}

const tools = document.querySelector(".zoom");
const recordings = tools.querySelector("select");
const whole = [Number(tools.dataset.start), Number(tools.dataset.end)];
const plots = [...document.querySelectorAll(".series svg.plot")].map((svg) => new Plot(svg, whole));
let [start, end] = whole;

function show(from, to) {
  const length = Math.min(Math.max(to - from, SHORTEST), whole[1] - whole[0]);
  const middle = (from + to) / 2;
  start = Math.min(Math.max(middle - length / 2, whole[0]), whole[1] - length);
  end = start + length;
  for (const plot of plots) plot.show([start, end]);
  if (recordings) recordings.selectedIndex = 0;
  const part = length < whole[1] - whole[0];
  const last = length < 60 ? 21 : 19;
  tools.classList.toggle("part", part);
  tools.querySelector("output").textContent = part
    ? `Shown: ${days([start, end])}, ${clock(start, 11, last)} to ${clock(end, 11, last)} UTC`
    : "Whole recording shown; drag over a figure to zoom.";
}

const actions = {
  in: (half, middle) => show(middle - half / 2, middle + half / 2),
  out: (half, middle) => show(middle - 2 * half, middle + 2 * half),
  earlier: (half) => show(start - half, end - half),
  later: (half) => show(start + half, end + half),
  all: () => show(...whole),
};
for (const button of tools.querySelectorAll("button")) {
  button.addEventListener("click", () => {
    actions[button.value]((end - start) / 2, (start + end) / 2);
  });
}

recordings?.addEventListener("change", () => {
  const chosen = recordings.selectedIndex;
  const { start: first, end: last } = recordings.selectedOptions[0].dataset;
  const margin = 0.02 * (last - first);
  if (first) show(Number(first) - margin, Number(last) + margin);
  else show(...whole);
  recordings.selectedIndex = chosen;
});

// Dragging with a mouse selects an interval; touching scrolls the page.
for (const plot of plots) {
  plot.svg.addEventListener("mousedown", (down) => {
    if (down.button !== 0) return;
    down.preventDefault();
    const from = plot.time(down);
    const chosen = element("rect", { y: plot.y, height: plot.height, class: "chosen" });
    plot.svg.append(chosen);
    const move = (event) => {
      const [left, right] = [from, plot.time(event)].sort((a, b) => a - b);
      chosen.setAttribute("x", plot.place(left));
      chosen.setAttribute("width", plot.place(right) - plot.place(left));
    };
    window.addEventListener("mousemove", move);
    window.addEventListener("mouseup", (up) => {
      window.removeEventListener("mousemove", move);
      chosen.remove();
      // A click without dragging selects nothing.
      if (Math.abs(up.clientX - down.clientX) > 5) {
        show(...[from, plot.time(up)].sort((a, b) => a - b));
      }
    }, { once: true });
  });
}

tools.hidden = false;
show(...whole);
