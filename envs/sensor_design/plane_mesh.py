"""Delaunay triangulation of a rectangle with given segments, refined to a size; called by `mesher`.

Coordinates are whole numbers (2^-20 mm), so every test is exact and the triangles are the same on every machine.
Ruppert, A Delaunay Refinement Algorithm for Quality 2-Dimensional Mesh Generation (1995): a segment that is missing or
has a point in its diametral circle is halved; a triangle that is too long or too thin gets its circumcentre. Insertion
of a point: Bowyer (1981), Watson (1981).
"""

import heapq
from math import sqrt

from vitac.errors import VitacError

Point = tuple[int, int]
Edge = tuple[int, int]
Triangle = tuple[int, int, int]

GRID_PER_MM = 2**20
# Circumradius over shortest edge, squared; 2 is the smallest for which refinement is proved to end (20.7 degrees).
_LARGEST_RATIO_SQUARED = 2.0


class TooManyPoints(VitacError):
    """A refinement needs more points than allowed; enlarge the triangles or coarsen what they must follow."""


class PlaneMesh:
    """Triangles of a rectangle that follow given segments.

    Args:
        half_x: half of the rectangle's extent along x [2^-20 mm]; its centre is the origin.
        half_y: the same along y.
        max_points: more are refused.

    Attributes:
        points: corners of the triangles [2^-20 mm]; the rectangle's corners come first.
        max_points: as given.
    """

    def __init__(self, half_x: int, half_y: int, *, max_points: int) -> None:
        self.points: list[Point] = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        self.max_points = max_points
        self._apex: dict[Edge, int] = {}
        self._segments: dict[Edge, bool] = {}
        self._created: list[Triangle] = []
        self._add_triangle(0, 1, 2)
        self._add_triangle(0, 2, 3)
        for a in range(4):
            self._segments[a, (a + 1) % 4] = False

    @property
    def triangles(self) -> list[Triangle]:
        """All triangles, counter-clockwise, from their lowest corner, ascending."""
        return sorted((a, b, c) for (a, b), c in self._apex.items() if a < b and a < c)

    @property
    def walls(self) -> set[Edge]:
        """Edges that lie on a segment marked as a wall, smaller index first."""
        return {_undirected(edge) for edge, is_wall in self._segments.items() if is_wall}

    def add_point(self, point: Point) -> int:
        """Return the index of a point of the rectangle, which becomes a corner of triangles if it is none yet.

        Raises:
            TooManyPoints: the limit is reached.
        """
        start = self._containing(point)
        for corner in start:
            if self.points[corner] == point:
                return corner
        if len(self.points) >= self.max_points:
            raise TooManyPoints(f"More than {self.max_points} points are needed.")
        self.points.append(point)
        self._fill(self._cavity(start, point), len(self.points) - 1)
        return len(self.points) - 1

    def add_near(self, point: Point, shortest: float) -> bool:
        """Add a point, or halve a segment that is nearer to it than the shortest one; False where that is too short."""
        edge = next((edge for edge in self._segments if _is_near(self._ends(edge), point, shortest)), None)
        if edge is None:
            self.add_point(point)
            return True
        if self._length(edge) <= 2.0 * shortest:
            return False
        self._split(edge)
        return True

    def add_segment(self, first: int, second: int, *, is_wall: bool) -> None:
        """Ask for edges along a segment between two points; heights may jump across a wall."""
        edge = (first, second) if (second, first) not in self._segments else (second, first)
        self._segments[edge] = is_wall or self._segments.get(edge, False)

    def conform(self, *, shortest: float) -> None:
        """Halve segments until every one is an edge and has no point in its diametral circle.

        Args:
            shortest: a segment that is an edge and shorter than this is left as it is.

        Raises:
            TooManyPoints: the limit is reached.
        """
        while (edge := next((edge for edge in self._segments if self._must_split(edge, shortest)), None)) is not None:
            self._split(edge)

    def refine(self, *, longest: float, shortest: float) -> None:
        """Add points until no triangle is too long or too thin.

        Args:
            longest: longest edge allowed [2^-20 mm].
            shortest: no segment below this length is halved for the sake of a triangle's shape.

        Raises:
            TooManyPoints: the limit is reached.
        """
        self.conform(shortest=shortest)
        heap: list[tuple[float, Triangle]] = []
        self._created = self.triangles
        while True:
            for triangle in self._created:
                if (badness := self._badness(triangle, longest)) > 1.0:
                    heapq.heappush(heap, (-badness, triangle))
            self._created = []
            if not heap:
                return
            negative, triangle = heapq.heappop(heap)
            if self._is_present(triangle) and self._improve(triangle, shortest) and self._is_present(triangle):
                heapq.heappush(heap, (negative, triangle))

    def _improve(self, triangle: Triangle, shortest: float) -> bool:
        """Insert the triangle's circumcentre, or halve the segments that it would crowd; False if neither can be.

        Each time there are more points or shorter segments, so that a refinement ends at the limit of points.
        """
        centre, before = self._circumcentre(triangle), len(self.points)
        crowded = [edge for edge in self._segments if _is_in_diametral_circle(self._ends(edge), centre)]
        if not crowded and self._is_inside(centre):
            return self.add_point(centre) == before
        long = [edge for edge in crowded if self._length(edge) > 2.0 * shortest]
        for edge in long:
            self._split(edge)
        self.conform(shortest=shortest)
        return bool(long)

    def _must_split(self, edge: Edge, shortest: float) -> bool:
        a, b = edge
        apexes = [self._apex[way] for way in ((a, b), (b, a)) if way in self._apex]
        if not apexes:
            return True
        if self._length(edge) <= shortest:
            return False
        return any(_is_in_diametral_circle(self._ends(edge), self.points[apex]) for apex in apexes)

    def _split(self, edge: Edge) -> None:
        """Cut a segment at the point that lies on it, else halve it: halving alone would creep up to that point."""
        (ax, ay), (bx, by) = self._ends(edge)
        middle = self._interpolate_point(edge)
        if middle is None:
            middle = self.add_point(((ax + bx) // 2, (ay + by) // 2))
        is_wall = self._segments.pop(edge)
        if middle in edge:
            raise TooManyPoints("Segments cross or lie on each other.")
        self.add_segment(edge[0], middle, is_wall=is_wall)
        self.add_segment(middle, edge[1], is_wall=is_wall)

    def _interpolate_point(self, edge: Edge) -> int | None:
        """Return the first point between the ends of a segment and exactly on it; None where there is none."""
        if edge in self._apex or edge[::-1] in self._apex:
            return None
        a, b = self._ends(edge)
        between = (
            number
            for number, point in enumerate(self.points)
            if _is_in_diametral_circle((a, b), point) and _orientation(a, b, point) == 0
        )
        return next(between, None)

    def _badness(self, triangle: Triangle, longest: float) -> float:
        """Return how far a triangle is from what is asked: above 1 it is to be improved."""
        squares = sorted(float(_squared(self.points[triangle[i - 1]], self.points[triangle[i]])) for i in range(3))
        a, b, c = (self.points[corner] for corner in triangle)
        double_area = float(_orientation(a, b, c))
        # Circumradius R = abc / (4 area).
        ratio_squared = squares[2] * squares[1] / (4.0 * double_area * double_area)
        return max(squares[2] / (longest * longest), ratio_squared / _LARGEST_RATIO_SQUARED)

    def _circumcentre(self, triangle: Triangle) -> Point:
        (ax, ay), (bx, by), (cx, cy) = (self.points[corner] for corner in triangle)
        bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
        double = 2 * (bx * cy - by * cx)
        b_squared, c_squared = bx * bx + by * by, cx * cx + cy * cy
        x, y = cy * b_squared - by * c_squared, bx * c_squared - cx * b_squared
        return ax + _rounded_ratio(x, double), ay + _rounded_ratio(y, double)

    def _is_inside(self, point: Point) -> bool:
        half_x, half_y = self.points[2]
        return abs(point[0]) <= half_x and abs(point[1]) <= half_y

    def _is_present(self, triangle: Triangle) -> bool:
        return self._apex.get((triangle[0], triangle[1])) == triangle[2]

    def _ends(self, edge: Edge) -> tuple[Point, Point]:
        return self.points[edge[0]], self.points[edge[1]]

    def _length(self, edge: Edge) -> float:
        return sqrt(_squared(*self._ends(edge)))

    def _containing(self, point: Point) -> Triangle:
        """Return a triangle that contains a point of the rectangle, by walking towards it."""
        (a, b), c = next(reversed(self._apex.items()))
        while True:
            for first, second in ((a, b), (b, c), (c, a)):
                if _orientation(self.points[first], self.points[second], point) < 0:
                    a, b, c = second, first, self._apex[second, first]
                    break
            else:
                return a, b, c

    def _cavity(self, start: Triangle, point: Point) -> list[Edge]:
        """Remove the triangles whose circumcircle holds a point; return the directed edges around them."""
        around: list[Edge] = []
        self._remove_triangle(start)
        pending = [(start[0], start[1]), (start[1], start[2]), (start[2], start[0])]
        while pending:
            a, b = pending.pop()
            apex = self._apex.get((b, a))
            if apex is not None and self._circle_holds(b, a, apex, point):
                self._remove_triangle((b, a, apex))
                pending += [(a, apex), (apex, b)]
            else:
                around.append((a, b))
        return around

    def _fill(self, around: list[Edge], index: int) -> None:
        point = self.points[index]
        for a, b in around:
            # Zero where the point lies on the rectangle's own edge.
            if _orientation(self.points[a], self.points[b], point) > 0:
                self._add_triangle(a, b, index)

    def _add_triangle(self, a: int, b: int, c: int) -> None:
        self._apex[a, b], self._apex[b, c], self._apex[c, a] = c, a, b
        self._created.append((a, b, c))

    def _remove_triangle(self, triangle: Triangle) -> None:
        a, b, c = triangle
        for edge in ((a, b), (b, c), (c, a)):
            self._apex.pop(edge, None)

    def _circle_holds(self, a: int, b: int, c: int, point: Point) -> bool:
        """Return whether a point lies strictly inside the circumcircle of a counter-clockwise triangle."""
        rows = []
        for corner in (a, b, c):
            x, y = self.points[corner][0] - point[0], self.points[corner][1] - point[1]
            rows.append((x, y, x * x + y * y))
        (ax, ay, aa), (bx, by, bb), (cx, cy, cc) = rows
        return ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx) > 0


def _orientation(a: Point, b: Point, c: Point) -> int:
    """Return twice the signed area of a triangle."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _squared(a: Point, b: Point) -> int:
    x, y = a[0] - b[0], a[1] - b[1]
    return x * x + y * y


def _is_in_diametral_circle(ends: tuple[Point, Point], point: Point) -> bool:
    (ax, ay), (bx, by) = ends
    return (ax - point[0]) * (bx - point[0]) + (ay - point[1]) * (by - point[1]) < 0


def _is_near(ends: tuple[Point, Point], point: Point, distance: float) -> bool:
    """Return whether a point is nearer to a segment than a distance."""
    (ax, ay), (bx, by) = ends
    along_x, along_y, to_x, to_y = bx - ax, by - ay, point[0] - ax, point[1] - ay
    fraction = min(1.0, max(0.0, (to_x * along_x + to_y * along_y) / _squared(*ends)))
    off_x, off_y = to_x - fraction * along_x, to_y - fraction * along_y
    return off_x * off_x + off_y * off_y < distance * distance


def _undirected(edge: Edge) -> Edge:
    return min(edge), max(edge)


def _rounded_ratio(numerator: int, denominator: int) -> int:
    return (2 * numerator + denominator) // (2 * denominator)
