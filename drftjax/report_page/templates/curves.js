"use strict";
// Draws the curves of the picked run with uPlot: for each quantity the curves, and what the models
// miss by. All values are data: they are put into the page as text and numbers only.
(() => {
  const HEIGHT = 150, RESIDUAL_HEIGHT = 96, AXIS = 28, AXIS_LABEL = 14, PRINTED_WIDTH = 640;
  const FEW = 5; // so few samples are marked, as a line through one does not show
  const root = document.documentElement;
  const curves = JSON.parse(document.getElementById("curves").textContent);
  const picker = document.getElementById("run");
  const place = document.getElementById("panels");
  let charts = [];

  const colour = (role) => getComputedStyle(root).getPropertyValue("--" + role).trim();
  const sum = (a, b) => (a === null || b === null ? null : a + b);
  const whole = (run) => [run.time[0], run.time[run.time.length - 1]];
  const picked = () => curves.runs[picker.selectedIndex] ?? curves.runs[0];
  const width = () =>
    root.classList.contains("printed") ? Math.min(PRINTED_WIDTH, place.clientWidth) : place.clientWidth;

  const follow = (chart, scale) => {
    if (scale !== "x") return;
    const { min, max } = chart.scales.x;
    for (const each of charts) {
      if (each.scales.x.min !== min || each.scales.x.max !== max) each.setScale("x", { min, max });
    }
  };

  const line = (role, panel, count) => ({
    label: curves.labels[role],
    stroke: colour(role),
    width: role === "recorded" ? 2.4 : 1.2,
    points: { show: count < FEW },
    value: (_, value) => (value === null || value === undefined ? "" : value.toFixed(panel.places)),
  });

  const add = (run, panel, heading, series, data, residual, timed, last) => {
    const box = document.createElement("div");
    box.className = "panel";
    const head = document.createElement("div");
    head.className = "panel-head";
    const title = document.createElement("b");
    title.textContent = heading;
    head.append(title);
    box.append(head);
    place.append(box);
    const axis = { stroke: colour("ink"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line"), width: 1 }, font: "11px system-ui, sans-serif" };
    const labelled = timed ? { size: AXIS } : { size: 4, values: (_, splits) => splits.map(() => "") };
    const named = last ? { label: "time [s]", labelSize: AXIS_LABEL, labelGap: 0, labelFont: axis.font } : {};
    const options = {
      width: width(),
      height: (residual ? RESIDUAL_HEIGHT : HEIGHT) + (last ? AXIS_LABEL : 0),
      padding: [6, 8, 0, 0],
      scales: { x: { time: false }, y: { dir: panel.downward ? -1 : 1 } },
      axes: [{ ...axis, ...labelled, ...named }, { ...axis, size: 58, space: residual ? 16 : 24 }],
      series: [{ label: "time", value: (_, value) => (value === null || value === undefined ? "" : value.toFixed(2) + " s") }, ...series],
      bands: residual && panel.floor !== null ? [{ series: [2, 1], fill: colour("floor") }] : [],
      legend: { show: !residual, markers: { fill: (chart, at) => chart.series[at].stroke() }, mount: (_, legend) => head.append(legend) },
      cursor: { sync: { key: "runs" }, drag: { x: true, y: false }, y: false },
      hooks: { setScale: [follow] },
    };
    charts.push(new uPlot(options, [run.time, ...data], box));
  };

  const draw = () => {
    for (const each of charts) each.destroy();
    charts = [];
    place.replaceChildren();
    const run = picked();
    const count = run.time.length;
    run.panels.forEach((panel, number) => {
      const models = ["before", "after"].filter((role) => panel[role] !== null);
      const measured = panel.recorded !== null;
      const roles = measured ? ["recorded", ...models] : models;
      const values = roles.map((role) =>
        measured && role !== "recorded" ? panel.recorded.map((value, at) => sum(value, panel[role][at])) : panel[role]);
      const final = number === run.panels.length - 1;
      const alone = !measured || models.length === 0;
      add(run, panel, `${panel.quantity} [${panel.unit}]`, roles.map((role) => line(role, panel, count)), values, false, alone, final && alone);
      if (alone) return;
      const edge = (sign) => run.time.map(() => sign * panel.floor);
      const floors = panel.floor === null ? [] : [edge(-1), edge(1)];
      const hidden = floors.map(() => ({ stroke: colour("floor"), width: 0, points: { show: false } }));
      const head = `simulated less recorded [${panel.unit}]` + (floors.length ? `, ${curves.labels.floor} ±${panel.floor.toPrecision(2)} in grey` : "");
      add(run, panel, head, [...hidden, ...models.map((role) => line(role, panel, count))], [...floors, ...models.map((role) => panel[role])], true, true, final);
    });
    place.dataset.run = run.name;
    document.getElementById("thinned").textContent = run.every > 1 ? `One sample of ${run.every} is drawn.` : "";
  };

  const ZOOMS = {
    earlier: (low, high) => [low - (high - low) / 2, high - (high - low) / 2],
    later: (low, high) => [low + (high - low) / 2, high + (high - low) / 2],
    closer: (low, high) => [low + (high - low) / 4, high - (high - low) / 4],
    wider: (low, high) => [low - (high - low) / 2, high + (high - low) / 2],
    whole: () => whole(picked()),
  };

  const zoom = (how) => {
    const [first, last] = whole(picked());
    const { min, max } = charts[0].scales.x;
    const [low, high] = ZOOMS[how](min, max);
    const span = Math.min(high - low, last - first);
    const start = Math.min(Math.max(low, first), last - span);
    charts[0].setScale("x", { min: start, max: start + span });
  };

  // uPlot listens to a mouse: one finger that moves sideways is passed on as one.
  const AS_MOUSE = { pointerdown: "mousedown", pointermove: "mousemove", pointerup: "mouseup" };
  for (const [touch, mouse] of Object.entries(AS_MOUSE)) {
    place.addEventListener(touch, (event) => {
      if (event.pointerType === "mouse") return;
      const to = mouse === "mouseup" ? document : event.target;
      to.dispatchEvent(new MouseEvent(mouse, { bubbles: true, clientX: event.clientX, clientY: event.clientY }));
    });
  }

  picker.addEventListener("change", draw);
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => zoom(button.dataset.zoom));
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addEventListener("beforeprint", () => { root.classList.add("printed"); draw(); });
  addEventListener("afterprint", () => { root.classList.remove("printed"); draw(); });
  new ResizeObserver(() => {
    for (const each of charts) {
      if (each.width !== width()) each.setSize({ width: width(), height: each.height });
    }
  }).observe(place);
  draw();
})();
