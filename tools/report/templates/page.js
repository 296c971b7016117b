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
    var drag = null;
    svg.addEventListener("pointerdown", function (event) {
      svg.focus({ preventScroll: true });
      drag = [event.clientX, event.clientY];
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", function (event) {
      var p = point(event);
      place.textContent = "east " + (east + p[0]).toFixed(2) + " m, north " + (north - p[1]).toFixed(2) + " m";
      if (!drag) return;
      var m = metresPerPixel();
      view[0] -= (event.clientX - drag[0]) * m;
      view[1] -= (event.clientY - drag[1]) * m;
      drag = [event.clientX, event.clientY];
      show();
    });
    svg.addEventListener("pointerup", function () { drag = null; });
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
