"""Tables of a case as classes, for scenes in Python: keys, defaults and units of docs/case.md.

    from particlerb.tables import Box, PushTable, RunTable

Each is made from its keys, `Box(size=(1, 1, 1), n=10)`; arrays stand for lists. A wrong key raises
`CaseError` with the words that a case file gets.
"""

from particlerb.case.bodies import (
    Body,
    GridPlacement,
    InBody,
    NormalDistribution,
    RandomBox,
    ShapePart,
)
from particlerb.case.contact import (
    BoxWall,
    ContactTable,
    CylinderWall,
    Material,
    MeshWall,
    Oscillation,
    Pair,
    Piston,
    PlaneWall,
    Prescribed,
)
from particlerb.case.forces import (
    CentralTable,
    DragTable,
    ImpulseTable,
    MagnusTable,
    PushTable,
    PythonTable,
    SpringTable,
    TimedLoad,
    TorqueTable,
    UniformField,
)
from particlerb.case.joints import InFrame, JointTable
from particlerb.case.output import ChartTable, Check, CheckValue, Output, Published
from particlerb.case.run import AttractionTable, Gravity, RunTable
from particlerb.case.shapes import (
    Ball,
    Box,
    Cloud,
    Cone,
    Cylinder,
    Ellipsoid,
    MeshShape,
    Moments,
    PointsShape,
    Rod,
    Shell,
    SpheresShape,
    Tetrahedron,
    Torus,
)
from particlerb.case.values import Euler

__all__ = [
    "AttractionTable",
    "Ball",
    "Body",
    "Box",
    "BoxWall",
    "CentralTable",
    "ChartTable",
    "Check",
    "CheckValue",
    "Cloud",
    "Cone",
    "ContactTable",
    "Cylinder",
    "CylinderWall",
    "DragTable",
    "Ellipsoid",
    "Euler",
    "Gravity",
    "GridPlacement",
    "ImpulseTable",
    "InBody",
    "InFrame",
    "JointTable",
    "MagnusTable",
    "Material",
    "MeshShape",
    "MeshWall",
    "Moments",
    "NormalDistribution",
    "Oscillation",
    "Output",
    "Pair",
    "Piston",
    "PlaneWall",
    "PointsShape",
    "Prescribed",
    "Published",
    "PushTable",
    "PythonTable",
    "RandomBox",
    "Rod",
    "RunTable",
    "ShapePart",
    "Shell",
    "SpheresShape",
    "SpringTable",
    "Tetrahedron",
    "TimedLoad",
    "TorqueTable",
    "Torus",
    "UniformField",
]
