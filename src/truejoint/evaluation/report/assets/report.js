"use strict";
(() => {
  const { figures, dark } = JSON.parse(document.getElementById("figures").textContent);
  const darkScreen = matchMedia("(prefers-color-scheme: dark)");
  const PAPER = { wide: 900, half: 440 }; // widths of figures in print, as in the style sheet [px]
  const NARROWEST = 210; // of a panel that stands beside others [px]
  const COLOURED = 1000; // dots of a colour each that a figure in print has
  const ROW = 230; // height of a panel that stands above others [px]
  const config = {
    displaylogo: false,
    displayModeBar: "hover",
    showSendToCloud: false,
    plotlyServerURL: "",
    modeBarButtonsToRemove: ["pan2d", "select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d"],
    toImageButtonOptions: { format: "svg" },
  };
  const chosen = new Map(figures.map((figure) => [figure.key, 0])); // variant shown
  const hidden = new Map(); // names in a legend, by figure, that the reader switched
  let printing = false;

  const place = (figure) => document.getElementById(`figure-${figure.key}`);
  const group = (trace) => trace.legendgroup || trace.name;

  /** Copy of plain values with the colours of dark paper; packed numbers are not walked through. */
  const inDark = (value) => {
    if (typeof value === "string") return dark[value] || value;
    if (Array.isArray(value)) return value.map(inDark);
    if (value === null || typeof value !== "object" || "bdata" in value) return value;
    return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, inDark(item)]));
  };

  /** Panels one above the other where they are too narrow side by side; colour bars beside theirs. */
  const arranged = ({ data, layout }, width) => {
    const fitted = { ...layout };
    const numbers = Object.keys(layout).filter((key) => /^xaxis\d*$/.test(key)).map((key) => key.slice(5));
    const domains = numbers.map((number) => String(layout[`xaxis${number}`].domain));
    const beside = new Set(domains).size;
    if (beside > 1 && width / beside < NARROWEST) {
      const left = layout.yaxis.title;
      const gap = 62 / (ROW * numbers.length);
      const row = (1 + gap) / numbers.length; // none below the last
      numbers.forEach((number, index) => {
        const y = layout[`yaxis${number}`];
        const title = y.title && y.title.text ? y.title : left;
        const top = 1 - index * row;
        fitted[`xaxis${number}`] = { ...layout[`xaxis${number}`], domain: [0, 1] };
        fitted[`yaxis${number}`] = { ...y, title, showticklabels: true, domain: [top - row + gap, top] };
      });
      fitted.height = ROW * numbers.length + 40;
    }
    const bars = data.map((trace) => {
      if (!trace.marker || !trace.marker.showscale || !trace.xaxis) return trace;
      const x = fitted[trace.xaxis.replace("x", "xaxis")].domain || [0, 1];
      const y = fitted[trace.yaxis.replace("y", "yaxis")].domain || [0, 1];
      const colorbar = { ...trace.marker.colorbar, x: x[1] + 0.005, y: (y[0] + y[1]) / 2, len: 0.95 * (y[1] - y[0]) };
      const marker = { ...trace.marker, colorbar };
      return { ...trace, marker };
    });
    return { data: bars, layout: fitted };
  };

  const numbers = ({ bdata }) =>
    Array.from(new Float32Array(Uint8Array.from(atob(bdata), (letter) => letter.charCodeAt(0)).buffer));

  /** Dots as a PDF takes them, a fortieth of the size: of one colour in one path, coloured ones fewer. */
  const onPaper = (trace) => {
    if (trace.mode !== "markers" || trace.text || !trace.x.bdata) return trace;
    const [places, { marker }] = [{ x: numbers(trace.x), y: numbers(trace.y) }, trace];
    if (typeof marker.color === "string") {
      const [x, y] = [places.x, places.y].map((values) => values.flatMap((value) => [value, value, null]));
      const line = { color: marker.color, width: marker.size, simplify: false };
      return { ...trace, x, y, mode: "lines", line, opacity: marker.opacity };
    }
    const step = Math.ceil(places.x.length / COLOURED);
    const [x, y, color] = [places.x, places.y, numbers(marker.color)].map((values) =>
      values.filter((_, index) => index % step === 0));
    return { ...trace, x, y, marker: { ...marker, color } };
  };

  const draw = (figure) => {
    const element = place(figure);
    let spec = figure.variants[chosen.get(figure.key)];
    const width = printing ? PAPER[element.parentElement.className] : element.clientWidth;
    spec = arranged(spec, width);
    if (printing) spec = { ...spec, data: spec.data.map(onPaper) };
    if (!printing && darkScreen.matches) spec = inDark(spec);
    const off = hidden.get(figure.key) || new Map();
    const data = spec.data.map((trace) =>
      off.has(group(trace)) ? { ...trace, visible: !off.get(group(trace)) } : trace);
    element.style.minHeight = `${spec.layout.height}px`;
    element.dataset.width = width;
    const drawn = Plotly.react(element, data, { ...spec.layout, width }, config);
    legend(figure, data);
    return drawn;
  };

  /** Names that can be switched by keyboard as by mouse. */
  const legend = (figure, data) => {
    const list = place(figure).previousElementSibling;
    const shown = data.filter((trace) => trace.name && trace.showlegend !== false);
    const names = [...new Map(shown.map((trace) => [group(trace), trace])).entries()];
    if (list.childElementCount !== names.length) {
      list.replaceChildren(...names.map(([name]) => {
        const button = document.createElement("button");
        button.type = "button";
        button.dataset.group = name;
        button.append(document.createElement("i"), "");
        button.addEventListener("click", () => {
          const off = hidden.get(figure.key) || new Map();
          hidden.set(figure.key, off.set(name, button.getAttribute("aria-pressed") === "true"));
          draw(figure);
        });
        return button;
      }));
    }
    names.forEach(([, trace], index) => {
      const button = list.children[index];
      const text = document.createElement("textarea"); // names come escaped, as plotly wants them
      text.innerHTML = trace.name;
      const colour = trace.fillcolor || (trace.line || trace.marker).color;
      button.firstChild.style.background = typeof colour === "string" ? colour : "";
      button.lastChild.textContent = text.value;
      button.setAttribute("aria-pressed", String(trace.visible === undefined || trace.visible === true));
    });
  };

  // One after the other, so that the page can be read while the rest is still being drawn.
  const queue = [...figures];
  const next = () => {
    const figure = queue.shift();
    if (figure) {
      draw(figure).then(() => setTimeout(next, 0));
    } else {
      document.documentElement.dataset.drawn = "yes";
    }
  };
  const redraw = () => {
    queue.length = 0;
    figures.forEach(draw);
  };
  next();

  addEventListener("beforeprint", () => {
    printing = true;
    redraw();
  });
  addEventListener("afterprint", () => {
    printing = false;
    redraw();
  });
  darkScreen.addEventListener("change", redraw);
  let waiting = 0;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      if (!printing) figures.filter((f) => Number(place(f).dataset.width) !== place(f).clientWidth).forEach(draw);
    }, 150);
  });

  const menu = document.getElementById("recording");
  if (menu) {
    menu.addEventListener("change", () => {
      figures.filter((f) => f.variants.length > 1).forEach((f) => {
        chosen.set(f.key, Number(menu.value));
        draw(f);
      });
    });
  }
})();
