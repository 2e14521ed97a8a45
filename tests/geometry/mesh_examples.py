"""Meshes for tests, made here without trimesh: vertices and faces that look outward."""

import math

import numpy as np

PHI = 0.5 * (1 + math.sqrt(5))


def box(size=(1.0, 1.0, 1.0)):
    """Two triangles per side."""
    v = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return (v - 0.5) * size, np.array(faces)


def octahedron():
    """Corners at distance 1 on the axes."""
    v = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    return v, np.array(faces)


def icosahedron():
    """Edge 2."""
    v = np.array([[0, s, t * PHI] for s in (1, -1) for t in (1, -1)])
    v = np.concatenate([np.roll(v, k, axis=1) for k in range(3)])
    near = np.abs(np.linalg.norm(v[:, None] - v, axis=2) - 2) < 1e-9
    faces = []
    for a in range(12):
        for b in range(a + 1, 12):
            for c in range(b + 1, 12):
                if near[a, b] and near[b, c] and near[a, c]:
                    up = np.dot(np.cross(v[b] - v[a], v[c] - v[a]), v[a]) > 0
                    faces.append((a, b, c) if up else (a, c, b))
    return v, np.array(faces)


def subdivided(v, faces):
    """Every face cut into four at the middles of its sides."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middle = len(v) + index.reshape(-1, 3)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    cut = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return (
        np.concatenate([v, v[unique].mean(axis=1)]),
        np.concatenate([np.stack(t, axis=1) for t in cut]),
    )


def sphere(levels):
    """Icosahedron, cut `levels` times, its vertices on the unit sphere."""
    v, faces = icosahedron()
    for _ in range(levels):
        v, faces = subdivided(v, faces)
        v = v / np.linalg.norm(v, axis=1, keepdims=True)
    return v / np.linalg.norm(v, axis=1, keepdims=True), faces


def torus(major, minor, around, across):
    """Two triangles per cell of a grid of angles."""
    u = 2 * math.pi * np.arange(around) / around
    w = 2 * math.pi * np.arange(across) / across
    U, W = (a.ravel() for a in np.meshgrid(u, w, indexing="ij"))
    r = major + minor * np.cos(W)
    i, j = (a.ravel() for a in np.indices((around, across)))
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([r * np.cos(U), r * np.sin(U), minor * np.sin(W)], axis=1), faces


def joined(*meshes):
    """Several meshes as one."""
    counts = np.cumsum([0] + [len(v) for v, _ in meshes])
    faces = [f + n for (_, f), n in zip(meshes, counts, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def inside_out(mesh):
    """Faces turned round."""
    return mesh[0], mesh[1][:, ::-1]
