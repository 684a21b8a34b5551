"use strict";
// One cursor for all plots: by the mouse, by the slider, or by a link to a moment.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const plots = [...document.querySelectorAll("svg.time")];
  const place = document.querySelector("svg.path circle.cursor");
  const time = document.getElementById("time");
  if (!plots.length || !time) return;

  const pointer = document.createElement("div");
  const slider = document.createElement("input");
  const told = document.createElement("b");
  pointer.id = "pointer";
  Object.assign(slider, { type: "range", min: 0, max: data.duration, step: "any", value: 0 });
  slider.setAttribute("aria-label", "time in seconds");
  pointer.append(told, slider);
  time.insertBefore(pointer, time.querySelector("figure"));

  // The index of the last row that is not later than t; rows begin with their time.
  const before = (rows, t) => {
    let low = 0, high = rows.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (rows[middle][0] <= t) low = middle + 1; else high = middle;
    }
    return low - 1;
  };

  const point = (t) => {
    t = Math.min(Math.max(t, 0), data.duration);
    document.body.classList.add("pointed");
    slider.value = t;
    const mode = data.modes[before(data.modes, t)];
    told.textContent = t.toFixed(2) + " s" + (mode ? "  " + mode[1].replace("_", " ") : "");
    const x = data.begin + (data.end - data.begin) * t / data.duration;
    for (const plot of plots) {
      plot.querySelector(".cursor").setAttribute("transform", "translate(" + x + " 0)");
      const lines = data.values[plot.id] || [];
      const now = lines.map((line) => {
        const row = line.points[before(line.points, t)];
        return row ? (line.name + " " + row[1]).trim() : "";
      });
      plot.closest("figure").querySelector(".now").textContent = now.filter(Boolean).join(", ");
    }
    const at = data.places[Math.max(before(data.places, t), 0)];
    if (place && at) {
      place.setAttribute("cx", at[1]);
      place.setAttribute("cy", at[2]);
    }
  };

  const choose = (t, id) => {
    for (const each of document.querySelectorAll(".moment.chosen")) each.classList.remove("chosen");
    const mark = id && document.getElementById(id);
    if (mark) mark.classList.add("chosen");
    point(t);
  };

  for (const plot of plots) {
    plot.addEventListener("pointermove", (event) => {
      const box = plot.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * plot.viewBox.baseVal.width;
      point((x - data.begin) / (data.end - data.begin) * data.duration);
    });
  }
  slider.addEventListener("input", () => point(Number(slider.value)));
  document.addEventListener("click", (event) => {
    const moment = event.target.closest("[data-t]");
    if (!moment) return;
    choose(Number(moment.dataset.t), moment.hash ? moment.hash.slice(1) : moment.id);
    if (moment.hash) {
      event.preventDefault();
      history.replaceState(null, "", moment.hash);
      time.scrollIntoView();
    }
  });
  const opened = document.getElementById(location.hash.slice(1));
  if (opened && opened.dataset.t) choose(Number(opened.dataset.t), opened.id);
  const asked = /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash);
  if (asked) {
    choose(Number(asked[1]));
    time.scrollIntoView();
  }
  addEventListener("beforeprint", () => {
    for (const each of document.querySelectorAll("details")) each.open = true;
  });
})();
