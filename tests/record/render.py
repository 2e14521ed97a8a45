"""Render one frame of a trajectory file with VTK, off screen: bodies as oriented boxes.

python render.py FILE STEP MASK.npy
"""

import sys

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkFiltersSources import vtkCubeSource
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkGlyph3DMapper,
    vtkRenderer,
    vtkRenderWindow,
    vtkWindowToImageFilter,
)

PIXELS, HALF_HEIGHT = 100, 2.0


def actor(path, step):
    """Bodies of a frame."""
    reader = vtkHDFReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    reader.SetStep(step)
    glyphs, cube = vtkGlyph3DMapper(), vtkCubeSource()
    glyphs.SetInputConnection(reader.GetOutputPort())
    glyphs.SetSourceConnection(cube.GetOutputPort())
    glyphs.SetOrientationModeToQuaternion()
    glyphs.SetOrientationArray("orientation")
    glyphs.SetScaleModeToScaleByVectorComponents()
    glyphs.SetScaleArray("extent")
    glyphs.ScalarVisibilityOff()
    bodies = vtkActor()
    bodies.SetMapper(glyphs)
    bodies.GetProperty().LightingOff()
    return bodies


def main(path, step, out):
    scene, window = vtkRenderer(), vtkRenderWindow()
    scene.AddActor(actor(path, int(step)))
    camera = scene.GetActiveCamera()
    camera.ParallelProjectionOn()
    camera.SetPosition(0, 0, 10)
    camera.SetParallelScale(HALF_HEIGHT)
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(0)
    window.SetSize(PIXELS, PIXELS)
    window.AddRenderer(scene)
    window.Render()
    image = vtkWindowToImageFilter()
    image.SetInput(window)
    image.Update()
    colours = vtk_to_numpy(image.GetOutput().GetPointData().GetScalars())
    np.save(out, colours.reshape(PIXELS, PIXELS, -1).max(axis=2) > 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
