"""Tables of a case as classes, for scenes in Python: keys, defaults and units of docs/case.md.

    from particlerb.tables import Box, PushTable, RunTable

Each is made from its keys, `Box(size=(1, 1, 1), n=10)`; arrays stand for lists. A wrong key raises
`CaseError` with the words that a case file gets. (`X as X` tells type checkers that X is public.)
"""

from particlerb.case.bodies import Body as Body
from particlerb.case.bodies import GridPlacement as GridPlacement
from particlerb.case.bodies import InBody as InBody
from particlerb.case.bodies import NormalDistribution as NormalDistribution
from particlerb.case.bodies import RandomBox as RandomBox
from particlerb.case.bodies import ShapePart as ShapePart
from particlerb.case.contact import BoxWall as BoxWall
from particlerb.case.contact import ContactTable as ContactTable
from particlerb.case.contact import CylinderWall as CylinderWall
from particlerb.case.contact import Material as Material
from particlerb.case.contact import MeshWall as MeshWall
from particlerb.case.contact import Oscillation as Oscillation
from particlerb.case.contact import Pair as Pair
from particlerb.case.contact import Piston as Piston
from particlerb.case.contact import PlaneWall as PlaneWall
from particlerb.case.contact import Prescribed as Prescribed
from particlerb.case.forces import CentralTable as CentralTable
from particlerb.case.forces import DragTable as DragTable
from particlerb.case.forces import ImpulseTable as ImpulseTable
from particlerb.case.forces import MagnusTable as MagnusTable
from particlerb.case.forces import PushTable as PushTable
from particlerb.case.forces import PythonTable as PythonTable
from particlerb.case.forces import SpringTable as SpringTable
from particlerb.case.forces import TimedLoad as TimedLoad
from particlerb.case.forces import TorqueTable as TorqueTable
from particlerb.case.forces import UniformField as UniformField
from particlerb.case.joints import InFrame as InFrame
from particlerb.case.joints import JointTable as JointTable
from particlerb.case.output import ChartTable as ChartTable
from particlerb.case.output import Check as Check
from particlerb.case.output import CheckValue as CheckValue
from particlerb.case.output import Output as Output
from particlerb.case.output import Published as Published
from particlerb.case.output import SweepValue as SweepValue
from particlerb.case.run import AttractionTable as AttractionTable
from particlerb.case.run import Gravity as Gravity
from particlerb.case.run import RunTable as RunTable
from particlerb.case.shapes import Ball as Ball
from particlerb.case.shapes import Box as Box
from particlerb.case.shapes import Cloud as Cloud
from particlerb.case.shapes import Cone as Cone
from particlerb.case.shapes import Cylinder as Cylinder
from particlerb.case.shapes import Ellipsoid as Ellipsoid
from particlerb.case.shapes import MeshShape as MeshShape
from particlerb.case.shapes import Moments as Moments
from particlerb.case.shapes import PointsShape as PointsShape
from particlerb.case.shapes import Rod as Rod
from particlerb.case.shapes import Shell as Shell
from particlerb.case.shapes import SpheresShape as SpheresShape
from particlerb.case.shapes import Tetrahedron as Tetrahedron
from particlerb.case.shapes import Torus as Torus
from particlerb.case.sweep import Spread as Spread
from particlerb.case.sweep import SweepTable as SweepTable
from particlerb.case.values import Euler as Euler
