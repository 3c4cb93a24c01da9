"use strict";
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const canvas = document.createElement("canvas");
  const hasWebGL = Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  const config = {
    responsive: true,
    displaylogo: false,
    showSendToCloud: false,
    plotlyServerURL: "",
    modeBarButtonsToRemove: ["pan2d", "select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d"],
    toImageButtonOptions: { format: "svg" },
  };

  const draw = (figure, variant) => {
    const place = document.getElementById(`figure-${figure.key}`);
    const flat = figure.flat && !hasWebGL;
    const spec = flat ? figure.flat : figure.variants[variant];
    place.style.minHeight = `${spec.layout.height}px`;
    if (flat && !place.dataset.flat) {
      place.dataset.flat = "yes";
      place.nextElementSibling.append(" (This browser has no WebGL: projections in place of 3-D.)");
    }
    return Plotly.react(place, spec.data, spec.layout, config);
  };

  // One after the other, so that the page can be read while the rest is still being drawn.
  const queue = [...figures];
  const next = () => {
    const figure = queue.shift();
    if (figure) {
      draw(figure, 0).then(() => setTimeout(next, 0));
    } else {
      document.documentElement.dataset.drawn = "yes";
    }
  };
  next();

  const menu = document.getElementById("recording");
  if (menu) {
    menu.addEventListener("change", () => {
      figures.filter((f) => f.variants.length > 1).forEach((f) => draw(f, Number(menu.value)));
    });
  }
})();
