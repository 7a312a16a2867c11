/* Source-calibrated threshold of the dead zones. Paper, remark "Dead-Zone
 * Threshold Selection". */

/* Restores the max-heap scores[0..count) below scores[root]. */
static COLD void heap_sink(real *scores, size_t root, size_t count) {
	while (2 * root + 1 < count) {
		size_t child = 2 * root + 1;
		if (child + 1 < count && scores[child + 1] > scores[child]) { child++; }
		if (!(scores[child] > scores[root])) { return; }
		const real t = scores[root];
		scores[root] = scores[child];
		scores[child] = t;
		root = child;
	}
}

static COLD void heap_sort(real *scores, size_t count) {
	for (size_t i = count / 2; i-- > 0;) { heap_sink(scores, i, count); }
	for (size_t last = count; last-- > 1;) {
		const real t = scores[0];
		scores[0] = scores[last];
		scores[last] = t;
		heap_sink(scores, 0, last);
	}
}

COLD int KOOP(threshold)(real *scores, size_t count, real eta, real *delta) {
	if (!scores || !delta) { return KOOP_E_NULL; }
	if (count < 1) { return KOOP_E_SIZE; }
	if (!(eta >= 0 && eta <= 1)) { return KOOP_E_RANGE; }
	if (!all_finite(scores, count)) { return KOOP_E_INPUT; }
	heap_sort(scores, count);

	const real h = (real)(count - 1) * eta;
	const size_t below = (size_t)h < count - 1 ? (size_t)h : count - 1;
	const size_t above = below + 1 < count ? below + 1 : below;
	const real fraction = h - (real)below;
	*delta = (1 - fraction) * scores[below] + fraction * scores[above];
	return KOOP_OK;
}
