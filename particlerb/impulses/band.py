"""Linear equations whose matrix has a band, by elimination with pivots in rows.

Source: Golub and Van Loan, Matrix Computations, 4th ed., section 4.3.
"""

from particlerb.compiled.jit import kernel
from particlerb.maths.vec3 import Floats


@kernel
def solve_band(matrix: Floats, x: Floats, bandwidth: int) -> None:
    """Solve A x = b in place: x comes in as b, and the matrix is used up.

    Parameters
    ----------
    matrix : ndarray, shape (n, 3 bandwidth + 1)
        A[i, j] in column j - i + bandwidth; nothing further from the diagonal, and space for what
        exchanges of rows bring.
    x : ndarray, shape (n,)
    bandwidth : int
    """
    n = x.size
    for i in range(n):
        end, width = min(n, i + bandwidth + 1), min(2 * bandwidth + 1, n - i)
        pivot = i
        for j in range(i + 1, end):
            if abs(matrix[j, i - j + bandwidth]) > abs(matrix[pivot, i - pivot + bandwidth]):
                pivot = j
        if pivot != i:
            x[i], x[pivot] = x[pivot], x[i]
            here, there = bandwidth, i - pivot + bandwidth
            for c in range(width):
                kept = matrix[i, here + c]
                matrix[i, here + c] = matrix[pivot, there + c]
                matrix[pivot, there + c] = kept
        for j in range(i + 1, end):
            there = i - j + bandwidth
            share = matrix[j, there] / matrix[i, bandwidth]
            if share != 0.0:
                for c in range(1, width):
                    matrix[j, there + c] -= share * matrix[i, bandwidth + c]
                x[j] -= share * x[i]
    for i in range(n - 1, -1, -1):
        for c in range(1, min(2 * bandwidth + 1, n - i)):
            x[i] -= matrix[i, bandwidth + c] * x[i + c]
        x[i] /= matrix[i, bandwidth]
