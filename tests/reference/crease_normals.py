"""Smooth normals the slow way: for each corner, walk from triangle to triangle around its vertex, in float64."""

import numpy as np


def crease_normals(vertices: np.ndarray, faces: np.ndarray, crease_angle: float) -> np.ndarray:
    """Normal [f 3 3] of each corner of each triangle."""
    p = np.asarray(vertices, np.float64)
    triangles = [tuple(int(i) for i in face) for face in faces]
    normals, weights = [], []
    for a, b, c in triangles:
        n = np.cross(p[b] - p[a], p[c] - p[a])
        normals.append(n / np.linalg.norm(n))
        angles = []
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            u, w = p[j] - p[i], p[k] - p[i]
            angles.append(np.arccos(np.clip(u @ w / np.linalg.norm(u) / np.linalg.norm(w), -1, 1)))
        weights.append(angles)
    around_edge: dict[frozenset, list[int]] = {}
    for f, (a, b, c) in enumerate(triangles):
        for edge in ((a, b), (b, c), (c, a)):
            around_edge.setdefault(frozenset(edge), []).append(f)
    result = np.zeros((len(triangles), 3, 3))
    for f, triangle in enumerate(triangles):
        for corner, vertex in enumerate(triangle):
            reached, waiting = {f}, [f]
            while waiting:
                here = waiting.pop()
                for other in triangles[here]:
                    owners = around_edge.get(frozenset((vertex, other)), [])
                    if other == vertex or len(owners) != 2:
                        continue
                    there = owners[0] if owners[1] == here else owners[1]
                    bend = np.degrees(np.arccos(np.clip(normals[here] @ normals[there], -1, 1)))
                    if there not in reached and bend <= crease_angle:
                        reached.add(there)
                        waiting.append(there)
            total = sum(weights[g][triangles[g].index(vertex)] * normals[g] for g in reached)
            result[f, corner] = total / np.linalg.norm(total)
    return result
