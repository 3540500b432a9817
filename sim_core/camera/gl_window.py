"""A drawing surface of VTK's without a screen: meshes with shaders of our own, drawn at once and read back."""

import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Nothing is shown: VTK needn't try an X server first, and complain where there is none.
if sys.platform == "linux":
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

from vtkmodules import vtkRenderingOpenGL2  # noqa: F401  (registers the OpenGL classes)
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkFloatArray, vtkLogger, vtkPoints, vtkUnsignedCharArray, vtkVersion
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkDataObject, vtkImageData, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkTexture

from sim_core.frames import Array

Floats = NDArray[np.float32]


class NoOpenGl(Exception):
    """VTK finds no OpenGL that draws without a screen."""


class GlTexture:
    """A picture that shaders look up, filtered linearly: bytes as 0 to 1, or floats as they are."""

    def __init__(self, pixels: NDArray[np.uint8] | Floats) -> None:
        self._image = vtkImageData()
        self.vtk = vtkTexture()
        self.vtk.SetInputData(self._image)
        self.vtk.InterpolateOn()
        self.vtk.RepeatOff()
        self.vtk.EdgeClampOn()
        self.vtk.SetColorModeToDirectScalars()
        self.set(pixels)

    def set(self, pixels: NDArray[np.uint8] | Floats) -> None:
        """Takes other pixels, shape [rows, columns, 3 or 4]; texture coordinate (0, 0) is at the first."""
        rows, columns, channels = pixels.shape
        self._pixels = np.ascontiguousarray(pixels).reshape(rows * columns, channels)
        self._image.SetDimensions(columns, rows, 1)
        self._image.GetPointData().SetScalars(numpy_to_vtk(self._pixels))
        self._image.Modified()

    def repeat(self) -> "GlTexture":
        """Goes on beyond its edges, like tiles."""
        self.vtk.RepeatOn()
        return self


class GlMesh:
    """Triangles on the graphics side. Attributes reach the vertex shader under their names; points as vertexMC.

    Args:
        points: places [m], shape [n, 3].
        triangles: rows of their corners, counter-clockwise from the front, shape [m, 3].
        shaders: vertex and fragment shader in GLSL.
        is_solid: what turns its back to the camera is hidden by its front.
        attributes: of the vertices, shape [n, 2] to [n, 4] each.
    """

    def __init__(
        self,
        points: Array,
        triangles: NDArray[np.int64],
        shaders: tuple[str, str],
        *,
        is_solid: bool = True,
        **attributes: Array,
    ) -> None:
        self._data = vtkPolyData()
        self._arrays: dict[str, tuple[Floats, Any]] = {}
        self._vtk_points = vtkPoints()
        self._arrays["points"] = self._array(points)
        self._vtk_points.SetData(self._arrays["points"][1])
        self._data.SetPoints(self._vtk_points)
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(self._data)
        # Points as they are: by default VTK shifts and scales them.
        mapper.SetVBOShiftScaleMethod(0)
        for name, values in attributes.items():
            self._arrays[name] = self._array(values)
            self._arrays[name][1].SetName(name)
            self._data.GetPointData().AddArray(self._arrays[name][1])
            mapper.MapDataArrayToVertexAttribute(name, name, vtkDataObject.FIELD_ASSOCIATION_POINTS, -1)
        self.set_triangles(triangles)
        self.actor = vtkActor()
        self.actor.SetMapper(mapper)
        self.actor.ForceOpaqueOn()
        self.actor.GetProperty().SetBackfaceCulling(is_solid)
        self._property = self.actor.GetShaderProperty()
        self._property.SetVertexShaderCode(shaders[0])
        self._property.SetFragmentShaderCode(shaders[1])

    @staticmethod
    def _array(values: Array) -> tuple[Floats, Any]:
        floats = np.array(values, dtype=np.float32, order="C")
        return floats, numpy_to_vtk(floats)

    def set(self, name: str, values: Array) -> None:
        """Other values of an attribute, or of ``points``, for as many vertices."""
        floats, array = self._arrays[name]
        floats[...] = values
        array.Modified()
        (self._vtk_points if name == "points" else self._data).Modified()

    def set_triangles(self, triangles: NDArray[np.int64]) -> None:
        """Other triangles of the same vertices, shape [m, 3]; they are drawn in this order."""
        cells = vtkCellArray()
        cells.SetData(3, numpy_to_vtkIdTypeArray(np.array(triangles, dtype=np.int64).ravel(), deep=True))
        self._data.SetPolys(cells)

    def set_texture(self, name: str, texture: GlTexture) -> None:
        """The texture that the shaders know by this name."""
        self.actor.GetProperty().SetTexture(name, texture.vtk)

    def set_uniform(self, name: str, value: float | Sequence[float] | Array) -> None:
        """A number, a vector of 2 to 4, or a 4 × 4 matrix that vertex and fragment shader know by this name."""
        numbers = np.asarray(value, dtype=float)
        for uniforms in (
            self._property.GetVertexCustomUniforms(),
            self._property.GetFragmentCustomUniforms(),
        ):
            if numbers.ndim == 2:
                # GLSL stores matrices by columns.
                uniforms.SetUniformMatrix4x4(name, numbers.T.ravel().tolist())
            elif numbers.ndim == 0:
                uniforms.SetUniformf(name, float(numbers))
            else:
                getattr(uniforms, f"SetUniform{len(numbers)}f")(name, numbers.tolist())


class GlWindow:
    """Draws meshes, the first one first, into a picture without a screen.

    Raises:
        NoOpenGl: there is none.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._window = _new_window()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._window.SetAlphaBitPlanes(1)
        self._window.SetSize(width, height)
        self._renderer = vtkRenderer()
        self._renderer.AutomaticLightCreationOff()
        # Without lights and frustum culling: our shaders and matrices know nothing of VTK's camera.
        self._renderer.GetCullers().RemoveAllItems()
        self._renderer.SetBackground(0.0, 0.0, 0.0)
        self._renderer.SetBackgroundAlpha(0.0)
        self._window.AddRenderer(self._renderer)
        self._colours = vtkUnsignedCharArray()
        self._depths = vtkFloatArray()
        if not self._window.SupportsOpenGL():
            raise NoOpenGl

    def add(self, mesh: GlMesh) -> None:
        """Draws this mesh too, after the others."""
        self._renderer.AddActor(mesh.actor)

    def remove(self, mesh: GlMesh) -> None:
        """Draws this mesh no more."""
        self._renderer.RemoveActor(mesh.actor)

    def draw(self, width: int | None = None, height: int | None = None) -> None:
        """Draws into the lower left part of the window."""
        share = ((width or self.width) / self.width, (height or self.height) / self.height)
        self._renderer.SetViewport(0.0, 0.0, *share)
        self._window.Render()

    def colours(self, width: int, height: int) -> NDArray[np.uint8]:
        """What was drawn: RGBA, shape [height, width, 4], its first row at the bottom; valid until the next draw."""
        self._window.GetRGBACharPixelData(0, 0, width - 1, height - 1, 0, self._colours, 0)
        pixels: NDArray[np.uint8] = vtk_to_numpy(self._colours).reshape(height, width, 4)
        return pixels

    def depths(self) -> Floats:
        """Depths of what was drawn, 0 near to 1 far, shape [height, width], its first row at the bottom."""
        self._window.GetZbufferData(0, 0, self.width - 1, self.height - 1, self._depths)
        depths: Floats = vtk_to_numpy(self._depths).reshape(self.height, self.width)
        return depths

    @property
    def described(self) -> str:
        """Which VTK and OpenGL draw; known after the first draw."""
        lines = (line.partition(":") for line in self._window.ReportCapabilities().splitlines())
        said = {name.strip(): value.strip() for name, _, value in lines}
        kind = self._window.GetClassName().removeprefix("vtk").removesuffix("RenderWindow")
        return f"VTK {vtkVersion().GetVTKVersion()}, {kind}, {said.get('OpenGL renderer string', 'OpenGL')}"

    def close(self) -> None:
        """Gives the context back."""
        self._window.Finalize()


def _new_window() -> vtkRenderWindow:
    cutoff = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        window = vtkRenderWindow()
    finally:
        vtkLogger.SetStderrVerbosity(cutoff)
    # VTK's last resort is OSMesa, which Mesa has given up; without it VTK ends the process at the first draw.
    if window.GetClassName() == "vtkOSOpenGLRenderWindow":
        raise NoOpenGl
    return window
