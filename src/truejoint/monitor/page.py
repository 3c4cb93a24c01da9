"""The page in the browser, made with viser: what is shown on it is given to it."""

import contextlib
import io
import socket
import threading
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Panel
from truejoint.errors import TruejointError
from truejoint.extras import require
from truejoint.monitor import panels
from truejoint.monitor.arm_drawing import ArmDrawing, Drawing, can_draw
from truejoint.monitor.samples import Condition, Samples
from truejoint.robots import Robot

LOOPBACK: Final = "127.0.0.1"
PORT: Final = 8080
FRAME_RATE: Final = 25.0  # pictures a second
PLOT_EVERY: Final = 5  # pictures after which the plots are drawn anew
WINDOW: Final = 60.0  # [s] that the plots show at most
_SPANS: Final = ("10 s", f"{WINDOW:.0f} s")

# The truth is a halo: what is right lies inside.
_OPACITY: Final = {"reported": None, "corrected": None, "truth": 0.25}
_THICKNESS: Final = {"reported": 0.7, "corrected": 0.72, "truth": 1.25}
_NARROW: Final = 0.75  # width by height of a window
_SIDES: Final = 8  # of a tube: without graphics hardware each corner costs
_PANEL_WIDTH: Final = 416  # [px]
_PLOT_HEIGHT: Final = 118  # [px]
_WIDE, _TALL = 880, 170  # [px] of the plots where no arm is drawn
_BAND: Final = {"series": (1, 2), "fill": panels.COLOURS["band"]}


class Page:
    """Shows samples of one arm, of `joints`, in the browser.

    `controls` is called once with viser's interface for widgets, to add its own, `more` with what
    the plots show and the joint chosen, for plots above them. It listens at `host` and `port`, 0
    for any that is free. Raises TruejointError if viser is not installed or nothing can listen
    there.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        controls: Callable[[Any], None],
        more: Callable[[Samples, str], list[Panel]] = lambda _shown, _joint: [],
        *,
        host: str,
        port: int,
    ) -> None:
        self._robot, self._joints, self._more = robot, tuple(joints), more
        whole = can_draw(robot) and self._joints == robot.joint_names
        self._drawing = ArmDrawing(robot) if whole else None
        self._lock = threading.RLock()  # of all below
        self._latest: Samples | None = None
        self._window: Samples | None = None  # what the plots show
        self._since = 0  # pictures since they were drawn
        self._bodies: dict[str, _Body] = {}
        self._plots: dict[tuple[str, ...], Any] = {}  # by what they show
        self._server, self.url, self.is_remote = _listening(host, port)
        self._lay_out(controls)

    def _lay_out(self, controls: Callable[[Any], None]) -> None:
        gui = self._server.gui
        gui.set_panel_label(self._robot.title)
        self._set_theme(dark=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_WIDTH)
        self._status = gui.add_html("")
        controls(gui)
        self._table = gui.add_html("")
        self._legend = gui.add_html("")
        gui.add_html(panels.filled("style"))
        if self._drawing is None:
            missing = "The kinematics of this robot are not known"
            if can_draw(self._robot):
                missing = "Not every joint is measured"
            gui.add_html(f'<div class="said">{missing}: no arm is drawn.</div>')
        else:
            self._set_stage(self._drawing)
        dark = gui.add_checkbox("Dark", initial_value=False)
        dark.on_update(lambda _: self._set_theme(dark=dark.value))
        panel = gui.add_panel()
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH if self._drawing is not None else _WIDE)
        self._plot_tab = panel.add_tab("Plots")
        with self._plot_tab:
            several = (panels.EVERY,) if len(self._joints) > 1 else ()
            self._joint = gui.add_dropdown("Joint", (*several, *self._joints), order=0.0)
            self._joint.visible = bool(several)
            self._span = gui.add_dropdown("Last", _SPANS, initial_value=_SPANS[-1], order=0.1)
        self._joint.on_update(lambda _: self._replot())
        self._span.on_update(lambda _: self._replot())

    def close(self) -> None:
        """Let the port go."""
        with _silent():
            self._server.stop()

    def render(
        self,
        samples: Samples | None,
        condition: Condition,
        *,
        silence: float = 0.0,
        at_once: bool = False,
    ) -> None:
        """Show the last row, now and then or `at_once` all over time; silent for `silence` [s]."""
        with self._lock, self._server.atomic():
            self._latest = samples
            self._since += 1
            self._status.content = panels.status_html(condition, samples, silence)
            if samples is None:
                return
            table = panels.table_html(samples, self._robot, is_fresh=condition.is_fresh)
            if table != self._table.content:
                self._table.content = table
            self._draw(samples, condition.is_fresh)
            if samples is not self._window and (at_once or self._since >= PLOT_EVERY):
                self._window, self._since = samples, 0
                self._replot()

    def say(self, error: Exception) -> None:
        """Tell all who look that something they asked for was refused, and why."""
        for client in self._server.get_clients().values():
            client.add_notification("Refused", str(error), color="red", auto_close_seconds=8.0)

    def stopped(self, error: Exception) -> None:
        """Say that nothing new will be shown, and why; what was shown last turns grey."""
        self.render(self._latest, Condition("the page has stopped", str(error), is_fresh=False))
        self._server.flush()

    def _set_theme(self, *, dark: bool) -> None:
        self._server.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="large"
        )

    def _set_stage(self, drawing: ArmDrawing) -> None:
        scene, size = self._server.scene, drawing.size
        points = drawing.at([self._robot.home]).balls[0]
        middle, lowest = 0.5 * (points.min(axis=0) + points.max(axis=0)), points[:, 2].min()
        scene.world_axes.visible = False
        scene.add_grid(
            "/floor", width=2 * size, height=2 * size, plane="xy", cell_size=size / 5,
            section_size=size, cell_color=(200, 203, 207), section_color=(170, 174, 178),
            cell_thickness=0.6, section_thickness=0.8, shadow_opacity=0.0,
            position=(0.0, 0.0, float(lowest - 0.25 * size)),
        )  # fmt: skip
        # Light without shadows: a control computer may draw without graphics hardware.
        scene.configure_environment_map(None)
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        scene.add_light_ambient("/light/all_round", intensity=0.7)
        scene.add_light_directional("/light/sun", intensity=1.7, position=(0.6, -1.0, 1.5))
        camera = self._server.initial_camera
        self._view = middle + size * np.array([0.95, -1.05, 0.45]), middle
        camera.position, camera.look_at = self._view
        camera.near, camera.far = 0.01 * size, 100 * size
        self._server.on_client_connect(self._welcome)

    def _welcome(self, client: Any) -> None:
        """Step back for who looks through a narrow window, whose lower half a sheet covers."""
        camera, (position, target) = client.camera, self._view
        if camera.aspect < _NARROW:
            back = 0.9 * (position - target)
            down = np.array([0.0, 0.0, 0.5 * np.linalg.norm(back)])
            with client.atomic():
                camera.position, camera.look_at = position + back - down, target - down

    def _draw(self, samples: Samples, is_fresh: bool) -> None:
        poses = panels.poses(samples, self._robot) if self._drawing is not None else {}
        if self._drawing is not None and poses:
            drawing = self._drawing.at(list(poses.values()))
            positions, wxyz, scales = drawing.cylinders()
            if new := [name for name in poses if name not in self._bodies]:
                self._bodies |= {name: _Body(self._server.scene, name, drawing) for name in new}
                shown = [name for name in panels.POSES if name in self._bodies]
                colours = [(panels.TITLES[name], panels.COLOURS[name]) for name in shown]
                self._legend.content = panels.filled("legend", colours)
            for k, name in enumerate(poses):
                self._bodies[name].place(positions[k], wxyz[k], scales[k], drawing.balls[k])
        for name, body in self._bodies.items():
            body.show(name in poses, is_fresh)

    def _replot(self) -> None:
        """Draw the plots; they are made anew only when other curves are known."""
        with self._lock, self._server.atomic():
            if self._window is None:
                return
            span = float(chosen(self._span).removesuffix(" s"))
            shown = self._window.window(self._window.t[-1], span).thinned()
            joint = chosen(self._joint)
            plots = [*self._more(shown, joint), *panels.plots(shown, self._robot, joint).values()]
            shapes = [(plot.y, *(curve.label for curve in plot.curves)) for plot in plots]
            if shapes != list(self._plots):
                for handle in self._plots.values():
                    handle.remove()
                with self._plot_tab:
                    made = [self._add_plot(plot, 1.0 + k) for k, plot in enumerate(plots)]
                self._plots = dict(zip(shapes, made, strict=True))
                return
            for handle, plot in zip(self._plots.values(), plots, strict=True):
                handle.data = _data(plot)

    def _add_plot(self, plot: Panel, order: float) -> Any:
        has_band = len(plot.curves) > 2 and not plot.curves[1].label
        y = np.array([curve.y for curve in plot.curves])
        # Curves with gaps have a fixed range: from a NaN none would be found.
        fixed = {} if np.isfinite(y).all() else {"y": {"range": (np.nanmin(y), np.nanmax(y))}}
        named: dict[str, Any] = {"width": 2.0, "points": {"show": False}}
        unnamed = named | {"width": 1.0, "class": "unnamed"}
        curves = (
            (named if curve.label else unnamed) | {"label": curve.label, "stroke": curve.colour}
            for curve in plot.curves
        )
        ticks = {"size": 4, "width": 1, "stroke": panels.COLOURS["stale"]}
        axis = {"font": "11px system-ui, sans-serif", "gap": 3, "ticks": ticks}
        return self._server.gui.add_uplot(
            _data(plot), ({"label": "t"}, *curves), title=plot.y,
            height=_PLOT_HEIGHT if self._drawing is not None else _TALL,
            bands=(_BAND,) if has_band else (),
            scales={"x": {"time": False}, **fixed},
            axes=({"size": 24, **axis}, {"size": 44, **axis}),
            legend={"show": sum(bool(curve.label) for curve in plot.curves) > 1, "live": False},
            padding=(4, 20, 0, 0),
            order=order,
        )  # fmt: skip


def chosen(dropdown: Any) -> str:
    """Give what is chosen, the first option where a stranger set something that is none."""
    return str(dropdown.value if dropdown.value in dropdown.options else dropdown.options[0])


def _data(plot: Panel) -> tuple[Any, ...]:
    return plot.curves[0].x, *(curve.y for curve in plot.curves)


class _Body:
    """One pose of the arm in the scene."""

    def __init__(self, scene: Any, name: str, drawing: Drawing) -> None:
        self._colour = _rgb(panels.COLOURS[name])
        self._thickness = _THICKNESS[name]
        mesh = require("trimesh", "monitor", "the monitor").creation

        def add(part: str, shape: Any, scales: Array) -> Any:  # where they are `place` says
            return scene.add_batched_meshes_simple(
                f"/{name}/{part}", shape.vertices, shape.faces,
                np.tile([1.0, 0, 0, 0], (len(scales), 1)), np.zeros((len(scales), 3)),
                batched_scales=scales, batched_colors=self._colour, opacity=_OPACITY[name],
                lod="off", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip

        tube = mesh.cylinder(1.0, 1.0, _SIDES)
        self._tubes = add("links", tube, np.ones((len(drawing.radii), 3)))
        self._balls = add("joints", mesh.icosphere(1), drawing.ball_radii * self._thickness)
        self.tool = np.zeros(3)

    def place(self, positions: Array, wxyz: Array, scales: Array, balls: Array) -> None:
        """Move it to where `Drawing.cylinders` and `Drawing.balls` are."""
        self._tubes.batched_positions = positions.astype(np.float32)
        self._tubes.batched_wxyzs = wxyz.astype(np.float32)
        thick = np.array([self._thickness, self._thickness, 1.0])
        self._tubes.batched_scales = (scales * thick).astype(np.float32)
        self._balls.batched_positions = balls.astype(np.float32)
        self.tool = balls[-1]

    def show(self, visible: bool, is_fresh: bool) -> None:
        """Show it or not, grey where it is not of now."""
        colour = self._colour if is_fresh else _rgb(panels.COLOURS["stale"])
        for part in (self._tubes, self._balls):
            if part.visible != visible:
                part.visible = visible
            if tuple(part.batched_colors) != colour:
                part.batched_colors = np.array(colour, dtype=np.uint8)


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def _listening(host: str, port: int) -> tuple[Any, str, bool]:
    """Give a server of viser's behind `access`, its address, and whether others may reach it."""
    viser = require("viser", "monitor", "the monitor")
    from truejoint.monitor import access  # noqa: PLC0415  # it needs what viser brings

    try:  # viser would look for another port, or forever
        with socket.create_server((host, port)):
            pass
    except (OSError, OverflowError, UnicodeError) as error:
        why = (getattr(error, "strerror", None) or str(error)).partition(" (while ")[0]
        raise TruejointError(
            f"{host}, port {port}: cannot listen there: {why}; give another --port"
        ) from None
    allowed = access.Access.of(host)
    with _silent(), access.guarded(allowed):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if port and server.get_port() != port:
        with _silent():
            server.stop()
        raise TruejointError(f"{host}, port {port}: taken; give another --port")
    server.request_share_url = lambda **_: None  # whoever asks: nothing leaves this computer
    return server, allowed.url(server.get_port()), bool(allowed.token)


def _silent() -> contextlib.AbstractContextManager[Any]:
    """Keep what viser prints when it starts and stops from the person's terminal."""
    return contextlib.redirect_stdout(io.StringIO())
