"use strict";
/* Pans and zooms the maps and switches their layers; the page is complete without it. */
(function () {
  function nice(length) {
    var power = Math.pow(10, Math.floor(Math.log10(length)));
    var steps = [5, 2, 1];
    for (var i = 0; i < 3; i++) if (steps[i] * power <= length) return steps[i] * power;
    return power;
  }
  function label(metres) {
    if (metres >= 1000) return metres / 1000 + " km";
    return metres >= 1 ? metres + " m" : Math.round(metres * 100) + " cm";
  }
  function attach(box) {
    var svg = box.querySelector("svg");
    var bar = box.querySelector(".scale");
    var place = box.querySelector(".place");
    var whole = svg.getAttribute("viewBox").split(" ").map(Number);
    var view = whole.slice();
    var east = Number(box.dataset.east), north = Number(box.dataset.north);
    function metresPerPixel() {
      var r = svg.getBoundingClientRect();
      return Math.max(view[2] / Math.max(r.width, 1), view[3] / Math.max(r.height, 1));
    }
    function show() {
      svg.setAttribute("viewBox", view.join(" "));
      var metres = nice(metresPerPixel() * 120);
      bar.style.width = metres / metresPerPixel() + "px";
      bar.textContent = label(metres);
    }
    function point(event) {
      var r = svg.getBoundingClientRect(), m = metresPerPixel();
      return [view[0] + view[2] / 2 + (event.clientX - r.left - r.width / 2) * m,
              view[1] + view[3] / 2 + (event.clientY - r.top - r.height / 2) * m];
    }
    function zoom(factor, at) {
      var width = Math.min(Math.max(view[2] * factor, 0.5), whole[2] * 4);
      var f = width / view[2];
      view = [at[0] + (view[0] - at[0]) * f, at[1] + (view[1] - at[1]) * f, view[2] * f, view[3] * f];
      show();
    }
    function middle() { return [view[0] + view[2] / 2, view[1] + view[3] / 2]; }
    svg.addEventListener("wheel", function (event) {
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== svg) return;
      event.preventDefault();
      zoom(Math.exp(event.deltaY * 0.0015), point(event));
    }, { passive: false });
    svg.addEventListener("dblclick", function (event) {
      event.preventDefault();
      zoom(event.shiftKey ? 2 : 0.5, point(event));
    });
    /* one finger or the mouse moves, two fingers also zoom about the middle between them */
    var held = {}, count = 0;
    function middleOf() {
      var sum = [0, 0], far = 0, all = Object.values(held);
      all.forEach(function (p) { sum[0] += p[0] / count; sum[1] += p[1] / count; });
      if (count === 2) far = Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]);
      return [sum[0], sum[1], far];
    }
    svg.addEventListener("pointerdown", function (event) {
      svg.focus({ preventScroll: true });
      if (count === 2) return;
      held[event.pointerId] = [event.clientX, event.clientY];
      count = Object.keys(held).length;
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", function (event) {
      var p = point(event);
      place.textContent = "east " + (east + p[0]).toFixed(2) + " m, north " + (north - p[1]).toFixed(2) + " m";
      if (!held[event.pointerId]) return;
      var before = middleOf();
      held[event.pointerId] = [event.clientX, event.clientY];
      var now = middleOf(), m = metresPerPixel();
      view[0] -= (now[0] - before[0]) * m;
      view[1] -= (now[1] - before[1]) * m;
      if (count === 2 && now[2] > 0) zoom(before[2] / now[2], point({ clientX: now[0], clientY: now[1] }));
      else show();
    });
    ["pointerup", "pointercancel"].forEach(function (name) {
      svg.addEventListener(name, function (event) {
        delete held[event.pointerId];
        count = Object.keys(held).length;
      });
    });
    svg.addEventListener("keydown", function (event) {
      var step = view[2] / 8, known = true;
      if (event.key === "+" || event.key === "=") zoom(0.7, middle());
      else if (event.key === "-") zoom(1 / 0.7, middle());
      else if (event.key === "0") { view = whole.slice(); show(); }
      else if (event.key === "ArrowLeft") { view[0] -= step; show(); }
      else if (event.key === "ArrowRight") { view[0] += step; show(); }
      else if (event.key === "ArrowUp") { view[1] -= step; show(); }
      else if (event.key === "ArrowDown") { view[1] += step; show(); }
      else known = false;
      if (known) event.preventDefault();
    });
    box.querySelectorAll("button").forEach(function (button) {
      button.addEventListener("click", function () {
        if (button.dataset.zoom === "0") { view = whole.slice(); show(); }
        else zoom(Number(button.dataset.zoom), middle());
      });
    });
    box.querySelectorAll("input[type=checkbox]").forEach(function (input) {
      input.addEventListener("change", function () {
        svg.querySelectorAll("g")[Number(input.dataset.layer)].style.display = input.checked ? "" : "none";
      });
    });
    window.addEventListener("resize", show);
    show();
  }
  document.querySelectorAll(".map").forEach(attach);
})();
