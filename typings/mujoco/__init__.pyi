# MuJoCo's compiled modules ship without types. Here are the parts that this project uses, as in
# MuJoCo 3.17; a test checks that each name is there. What is missing here is an error to a type
# checker: add it.

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int32]

__version__: str

class _Vector:
    """A field that returns an array and takes any numbers of that shape."""

    def __get__(self, instance: object, owner: type) -> _Floats: ...
    def __set__(self, instance: object, value: ArrayLike) -> None: ...

class _Enum:
    def __int__(self) -> int: ...

class mjtBuiltin(_Enum):
    mjBUILTIN_FLAT: ClassVar[Self]

class mjtDisableBit(_Enum):
    mjDSBL_CONTACT: ClassVar[Self]
    mjDSBL_GRAVITY: ClassVar[Self]
    mjDSBL_CLAMPCTRL: ClassVar[Self]
    mjDSBL_AUTORESET: ClassVar[Self]
    mjDSBL_EULERDAMP: ClassVar[Self]

class mjtEq(_Enum):
    mjEQ_JOINT: ClassVar[Self]
    mjEQ_TENDON: ClassVar[Self]

class mjtGeom(_Enum):
    mjGEOM_SPHERE: ClassVar[Self]
    mjGEOM_CYLINDER: ClassVar[Self]
    mjGEOM_BOX: ClassVar[Self]
    mjGEOM_MESH: ClassVar[Self]

class mjtMeshInertia(_Enum):
    mjMESH_INERTIA_SHELL: ClassVar[Self]

class mjtIntegrator(_Enum):
    mjINT_EULER: ClassVar[Self]
    mjINT_RK4: ClassVar[Self]
    mjINT_IMPLICIT: ClassVar[Self]
    mjINT_IMPLICITFAST: ClassVar[Self]
    mjINT_DISCRETE: ClassVar[Self]

class mjtJacobian(_Enum):
    mjJAC_DENSE: ClassVar[Self]
    mjJAC_SPARSE: ClassVar[Self]

class mjtJoint(_Enum):
    mjJNT_FREE: ClassVar[Self]
    mjJNT_HINGE: ClassVar[Self]
    mjJNT_SLIDE: ClassVar[Self]

class mjtLightType(_Enum):
    mjLIGHT_DIRECTIONAL: ClassVar[Self]

class mjtLimited(_Enum):
    mjLIMITED_FALSE: ClassVar[Self]
    mjLIMITED_TRUE: ClassVar[Self]

class mjtObj(_Enum):
    mjOBJ_XBODY: ClassVar[Self]
    mjOBJ_JOINT: ClassVar[Self]
    mjOBJ_SITE: ClassVar[Self]
    mjOBJ_TENDON: ClassVar[Self]

class mjtSensor(_Enum):
    mjSENS_FRAMEPOS: ClassVar[Self]
    mjSENS_FRAMELINVEL: ClassVar[Self]
    mjSENS_FRAMEANGVEL: ClassVar[Self]
    mjSENS_JOINTLIMITFRC: ClassVar[Self]

class mjtSolver(_Enum):
    mjSOL_PGS: ClassVar[Self]
    mjSOL_CG: ClassVar[Self]
    mjSOL_NEWTON: ClassVar[Self]

class mjtConstraint(_Enum):
    mjCNSTR_FRICTION_TENDON: ClassVar[Self]

class mjtStage(_Enum):
    mjSTAGE_NONE: ClassVar[Self]
    mjSTAGE_VEL: ClassVar[Self]

class mjtState(_Enum):
    mjSTATE_INTEGRATION: ClassVar[Self]

class mjtTexture(_Enum):
    mjTEXTURE_SKYBOX: ClassVar[Self]

class mjtTrn(_Enum):
    mjTRN_JOINT: ClassVar[Self]

# -- the specification of a model ------------------------------------------------------------------

class MjOption:
    timestep: float
    gravity: _Vector
    integrator: int | mjtIntegrator
    solver: int | mjtSolver
    disableflags: int
    iterations: int
    tolerance: float
    jacobian: int | mjtJacobian

class MjsCompiler:
    degree: bool

class MjStatistic:
    extent: float
    center: _Vector

class _Headlight:
    ambient: _Vector

class _Global:
    offwidth: int
    offheight: int

class MjVisual:
    headlight: _Headlight
    global_: _Global

class _MjsElement:
    name: str

class MjsGeom(_MjsElement): ...
class MjsSensor(_MjsElement): ...
class MjsLight(_MjsElement): ...
class MjsMesh(_MjsElement): ...

class MjsSite(_MjsElement):
    pos: _Floats

class MjsEquality(_MjsElement):
    type: mjtEq
    active: bool
    solref: _Vector
    solimp: _Vector

class _Limited(_MjsElement):
    limited: mjtLimited
    range: _Vector
    solref_limit: _Vector
    solimp_limit: _Vector

class MjsJoint(_Limited):
    type: mjtJoint
    armature: float
    damping: _Floats
    stiffness: _Floats

class MjsTendon(_Limited):
    stiffness: _Vector
    springlength: _Vector
    def wrap_site(self, name: str) -> object: ...
    def wrap_pulley(self, divisor: float) -> object: ...

class MjsActuator(_MjsElement):
    gainprm: _Vector
    biasprm: _Vector
    forcelimited: bool
    forcerange: _Vector
    ctrllimited: bool
    ctrlrange: _Vector
    def set_to_position(self, kp: float) -> None: ...

class MjsBody(_MjsElement):
    pos: _Floats
    def add_body(
        self,
        *,
        name: str = ...,
        pos: ArrayLike = ...,
        quat: ArrayLike = ...,
        mocap: bool = ...,
        mass: float = ...,
        inertia: ArrayLike = ...,
        ipos: ArrayLike = ...,
        explicitinertial: bool = ...,
    ) -> MjsBody: ...
    def add_freejoint(self, *, name: str = ...) -> MjsJoint: ...
    def add_joint(
        self,
        *,
        name: str = ...,
        type: mjtJoint = ...,
        axis: ArrayLike = ...,
        damping: float = ...,
        stiffness: float = ...,
        springref: float = ...,
        limited: mjtLimited = ...,
        range: ArrayLike = ...,
    ) -> MjsJoint: ...
    def add_geom(
        self,
        *,
        type: mjtGeom = ...,
        size: ArrayLike = ...,
        pos: ArrayLike = ...,
        meshname: str = ...,
        rgba: ArrayLike = ...,
        contype: int = ...,
        conaffinity: int = ...,
        density: float = ...,
        group: int = ...,
    ) -> MjsGeom: ...
    def add_site(
        self, *, name: str = ..., pos: ArrayLike = ..., size: ArrayLike = ..., rgba: ArrayLike = ...
    ) -> MjsSite: ...
    def add_camera(
        self, *, name: str = ..., pos: ArrayLike = ..., xyaxes: ArrayLike = ...
    ) -> _MjsElement: ...
    def add_light(
        self, *, pos: ArrayLike = ..., dir: ArrayLike = ..., type: mjtLightType = ...
    ) -> MjsLight: ...

class MjSpec:
    modelname: str
    modelfiledir: str
    compiler: MjsCompiler
    option: MjOption
    stat: MjStatistic
    visual: MjVisual
    actuators: list[MjsActuator]
    worldbody: MjsBody
    bodies: list[MjsBody]
    geoms: list[MjsGeom]
    joints: list[MjsJoint]
    lights: list[MjsLight]
    sensors: list[MjsSensor]
    sites: list[MjsSite]
    tendons: list[MjsTendon]
    equalities: list[MjsEquality]
    def __init__(self) -> None: ...
    @staticmethod
    def from_file(filename: str) -> MjSpec: ...
    def add_mesh(
        self, *, name: str = ..., file: str = ..., inertia: mjtMeshInertia = ...
    ) -> MjsMesh: ...
    def add_tendon(
        self,
        *,
        name: str = ...,
        limited: mjtLimited = ...,
        range: ArrayLike = ...,
        frictionloss: float = ...,
        solref_friction: ArrayLike = ...,
        solimp_friction: ArrayLike = ...,
        solref_limit: ArrayLike = ...,
        solimp_limit: ArrayLike = ...,
        width: float = ...,
        rgba: ArrayLike = ...,
    ) -> MjsTendon: ...
    def add_equality(
        self,
        *,
        name: str = ...,
        type: mjtEq = ...,
        objtype: mjtObj = ...,
        name1: str = ...,
        name2: str = ...,
        active: bool = ...,
        data: ArrayLike = ...,
        solref: ArrayLike = ...,
        solimp: ArrayLike = ...,
    ) -> MjsEquality: ...
    def add_actuator(
        self,
        *,
        name: str = ...,
        trntype: mjtTrn = ...,
        target: str = ...,
        ctrllimited: mjtLimited = ...,
    ) -> MjsActuator: ...
    def add_sensor(
        self, *, name: str = ..., type: mjtSensor = ..., objtype: mjtObj = ..., objname: str = ...
    ) -> MjsSensor: ...
    def add_key(
        self, *, name: str = ..., qpos: ArrayLike = ..., ctrl: ArrayLike = ...
    ) -> _MjsElement: ...
    def add_texture(
        self,
        *,
        name: str = ...,
        type: mjtTexture = ...,
        builtin: mjtBuiltin = ...,
        rgb1: ArrayLike = ...,
        rgb2: ArrayLike = ...,
        width: int = ...,
        height: int = ...,
    ) -> _MjsElement: ...
    def tendon(self, name: str) -> MjsTendon: ...
    def delete(self, element: _MjsElement) -> None: ...
    def compile(self) -> MjModel: ...
    def to_xml(self) -> str: ...

# -- a model, its data, and functions --------------------------------------------------------------

class _NamedInModel:
    """One element of a model; which of these fields there are depends on its kind."""

    id: int
    name: str
    size: _Floats
    mass: _Floats
    inertia: _Floats
    iquat: _Floats
    subtreemass: _Floats
    stiffness: _Floats
    damping: _Floats
    range: _Floats
    gainprm: _Floats
    biasprm: _Floats

class _Camera:
    name: str
    xpos: _Floats
    xmat: _Floats

class MjModel:
    nq: int
    nv: int
    neq: int
    qpos0: _Floats
    M_rownnz: _Ints
    M_colind: _Ints
    site_bodyid: _Ints
    body_rootid: _Ints
    ncam: int
    nmesh: int
    ntex: int
    tex_type: _Ints
    tex_data: NDArray[np.uint8]
    tex_height: _Ints
    tex_width: _Ints
    def camera(self, which: int) -> _Camera: ...
    nbody: int
    ntendon: int
    opt: MjOption
    stat: MjStatistic
    vis: MjVisual
    dof_armature: _Floats
    dof_damping: _Floats
    jnt_type: _Ints
    jnt_limited: _Ints
    jnt_range: _Floats
    jnt_solref: _Floats
    jnt_solimp: _Floats
    geom_bodyid: _Ints
    site_bodyid: _Ints
    site_pos: _Floats
    site_size: _Floats
    geom_contype: _Ints
    geom_conaffinity: _Ints
    geom_group: _Ints
    geom_size: _Floats
    geom_rgba: NDArray[np.float32]
    tendon_length0: _Floats
    tendon_limited: _Ints
    tendon_solref_lim: _Floats
    tendon_solimp_lim: _Floats
    tendon_range: _Floats
    tendon_stiffness: _Floats
    tendon_width: _Floats
    tendon_lengthspring: _Floats
    light_pos: _Floats
    light_dir: _Floats
    tendon_invweight0: _Floats
    eq_type: _Ints
    eq_obj1id: _Ints
    eq_obj2id: _Ints
    eq_active0: _Ints
    eq_data: _Floats
    eq_solref: _Floats
    actuator_gainprm: _Floats
    actuator_biasprm: _Floats
    eq_solimp: _Floats
    ten_J_rownnz: _Ints
    ten_J_rowadr: _Ints
    ten_J_colind: _Ints
    @staticmethod
    def from_xml_path(filename: str) -> MjModel: ...
    def body(self, name: int | str) -> _NamedInModel: ...
    def joint(self, name: int | str) -> _NamedInModel: ...
    def site(self, name: int | str) -> _NamedInModel: ...
    def actuator(self, name: int | str) -> _NamedInModel: ...

class _NamedInData:
    """One element of a model's data; which of these fields there are depends on its kind."""

    xpos: _Floats
    xipos: _Floats

class MjData:
    model: MjModel
    def camera(self, which: str) -> _Camera: ...
    time: float
    xipos: _Floats
    xmat: _Floats
    xfrc_applied: _Floats
    geom_xpos: _Floats
    qpos: _Floats
    qvel: _Floats
    ctrl: _Vector
    qfrc_bias: _Floats
    qfrc_passive: _Floats
    subtree_com: _Floats
    ten_length: _Floats
    ten_J: _Floats
    efc_type: _Ints
    efc_id: _Ints
    efc_force: _Floats
    def __init__(self, model: MjModel) -> None: ...
    def body(self, name: int | str) -> _NamedInData: ...
    def site(self, name: int | str) -> _NamedInData: ...

mjNEQDATA: int

def mj_step(m: MjModel, d: MjData, nstep: int = 1) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mj_fwdPosition(m: MjModel, d: MjData) -> None: ...
def mj_fwdVelocity(m: MjModel, d: MjData) -> None: ...
def mj_applyFT(
    m: MjModel,
    d: MjData,
    force: _Floats,
    torque: _Floats,
    point: _Floats,
    body: int,
    qfrc_target: _Floats,
) -> None: ...
def mj_fullM(m: MjModel, d: MjData, dst: _Floats) -> None: ...
def mj_jacSite(
    m: MjModel, d: MjData, jacp: _Floats | None, jacr: _Floats | None, site: int
) -> None: ...
def mj_getState(m: MjModel, d: MjData, state: _Floats, sig: int) -> None: ...
def mj_setState(m: MjModel, d: MjData, state: _Floats, sig: int) -> None: ...
def mju_sparse2dense(
    res: _Floats, mat: _Floats, rownnz: _Ints, rowadr: _Ints, colind: _Ints
) -> None: ...

# -- pictures --------------------------------------------------------------------------------------

class MjvCamera:
    lookat: _Floats
    distance: float
    azimuth: float
    elevation: float
    def __init__(self) -> None: ...

class MjvGeom:
    pos: _Floats
    size: _Floats
    rgba: _Floats

class MjvGLCamera:
    pos: _Floats
    forward: _Floats
    frustum_top: float
    frustum_near: float

class MjvScene:
    ngeom: int
    geoms: Sequence[MjvGeom]
    camera: Sequence[MjvGLCamera]
    def __init__(self, model: MjModel, maxgeom: int) -> None: ...

class MjvOption:
    def __init__(self) -> None: ...

class mjtCatBit(_Enum):
    mjCAT_ALL: ClassVar[Self]

def mjv_updateScene(
    m: MjModel,
    d: MjData,
    opt: MjvOption,
    pert: None,
    cam: MjvCamera,
    catmask: int,
    scn: MjvScene,
) -> None: ...
def mjv_initGeom(
    geom: MjvGeom,
    type: mjtGeom,
    size: NDArray[np.float64],
    pos: NDArray[np.float64],
    mat: NDArray[np.float64],
    rgba: NDArray[np.float32],
) -> None: ...

class Renderer:
    scene: MjvScene
    def __init__(self, model: MjModel, height: int = 240, width: int = 320) -> None: ...
    def update_scene(self, data: MjData, camera: int | str | MjvCamera = -1) -> None: ...
    def render(self) -> NDArray[np.uint8]: ...
    def close(self) -> None: ...
