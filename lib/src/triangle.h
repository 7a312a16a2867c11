/* Layout of a triangular matrix in tiles of 4 x 4. */

/* Index of element (i, j), j <= i. */
#define TRIANGLE_AT(i, j)                                                                                    \
	((i) / 4u * ((i) / 4u + 1u) * 8u + (size_t)(j) / 4u * 16u + (i) % 4u * 4u + (j) % 4u)
