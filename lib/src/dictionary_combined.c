/* Dictionaries that are put together of parts: the state, then the functions of each part in turn. */

/* Returns 1 if all indices are those of states. */
static COLD int indices_in_range(const unsigned char *index, size_t count, size_t n_states) {
	int in_range = index && count > 0;
	for (size_t i = 0; in_range && i < count; i++) { in_range = index[i] < n_states; }
	return in_range;
}

/* ---- Constant --------------------------------------------------------------------- */

static COLD size_t count_constant(const void *context, size_t n_states) {
	(void)context;
	(void)n_states;
	return 1;
}

static real *write_constant(const void *context, const real *x, real *out) {
	(void)context;
	(void)x;
	*out++ = 1;
	return out;
}

const KOOP(part_kind) KOOP(part_constant) = {count_constant, write_constant};

/* ---- Angles ------------------------------------------------------------------------ */

static COLD size_t count_angles(const void *context, size_t n_states) {
	const KOOP(angles) *own = (const KOOP(angles) *)context;
	const int fits = own && own->n <= KOOP_MAX_DIM && (own->wrapped == 0 || own->wrapped == 1);
	return fits && indices_in_range(own->states, own->n, n_states) ? own->n * (own->wrapped ? 3u : 2u) : 0;
}

static real *write_angles(const void *context, const real *x, real *out) {
	const KOOP(angles) *own = (const KOOP(angles) *)context;
	for (size_t i = 0; i < own->n; i++) {
		KOOP(angle) angle;
		reduce(&angle, x[own->states[i]]);
		sine_cosine(&angle, out);
		out += 2;
		if (own->wrapped) { *out++ = wrapped(&angle); }
	}
	return out;
}

const KOOP(part_kind) KOOP(part_angles) = {count_angles, write_angles};

/* ---- Products ------------------------------------------------------------------------ */

static COLD size_t count_products(const void *context, size_t n_states) {
	const KOOP(products) *own = (const KOOP(products) *)context;
	const int fits = own && own->n <= KOOP_MAX_DIM && indices_in_range(own->pairs, 2 * own->n, n_states);
	return fits ? own->n : 0;
}

static real *write_products(const void *context, const real *x, real *out) {
	const KOOP(products) *own = (const KOOP(products) *)context;
	for (size_t i = 0; i < own->n; i++) { out[i] = x[own->pairs[2 * i]] * x[own->pairs[2 * i + 1]]; }
	return out + own->n;
}

const KOOP(part_kind) KOOP(part_products) = {count_products, write_products};

/* ---- Polynomials ----------------------------------------------------------------------- */

/* Number of monomials of the degrees from `low` to `high` of n variables: sum of (n + k - 1 over k), or more
 * than KOOP_MAX_DIM. */
static COLD size_t count_monomials(size_t n, size_t low, size_t high) {
	size_t of_degree = 1, count = low == 0 ? 1 : 0;
	for (size_t k = 1; k <= high; k++) {
		of_degree = of_degree * (n + k - 1) / k;
		if (of_degree > KOOP_MAX_DIM) { return of_degree; }
		count += k >= low ? of_degree : 0;
	}
	return count;
}

static COLD size_t count_polynomials(const void *context, size_t n_states) {
	const KOOP(polynomials) *own = (const KOOP(polynomials) *)context;
	if (!own || own->low > own->high || own->high > KOOP_MAX_DEGREE || own->n > KOOP_MAX_DIM) { return 0; }
	const int known = indices_in_range(own->states, own->n, n_states);
	return known ? count_monomials(own->n, own->low, own->high) : 0;
}

/* The next factors i[0] <= i[1] <= .. < n of a monomial of this degree; returns 0 after the last. */
static int next_monomial(size_t *factor, size_t degree, size_t n) {
	size_t last = degree;
	while (last > 0 && factor[last - 1] == n - 1) { last--; }
	if (last == 0) { return 0; }
	const size_t next = factor[last - 1] + 1;
	for (size_t k = last - 1; k < degree; k++) { factor[k] = next; }
	return 1;
}

static real monomial(const KOOP(polynomials) *own, const real *x, const size_t *factor, size_t degree) {
	real value = 1;
	for (size_t k = 0; k < degree; k++) { value *= x[own->states[factor[k]]]; }
	return value;
}

static real *write_polynomials(const void *context, const real *x, real *out) {
	const KOOP(polynomials) *own = (const KOOP(polynomials) *)context;
	for (size_t degree = own->low; degree <= own->high; degree++) {
		size_t factor[KOOP_MAX_DEGREE] = {0};
		do { *out++ = monomial(own, x, factor, degree); } while (next_monomial(factor, degree, own->n));
	}
	return out;
}

const KOOP(part_kind) KOOP(part_polynomials) = {count_polynomials, write_polynomials};

/* ---- Radial basis functions ---------------------------------------------------------------- */

static COLD int rbf_is_given(const KOOP(rbf) *own) {
	return own->kernel && own->kernel->values && own->centers && own->widths;
}

static COLD size_t count_rbf(const void *context, size_t n_states) {
	const KOOP(rbf) *own = (const KOOP(rbf) *)context;
	if (!own || !rbf_is_given(own)) { return 0; }
	if (own->n > KOOP_MAX_DIM || own->count > KOOP_MAX_DIM) { return 0; }
	int sound = indices_in_range(own->states, own->n, n_states) && all_finite(own->centers, own->n * own->count);
	for (size_t i = 0; i < own->count; i++) { sound &= is_within(own->widths[i], REAL_MIN, REAL_MAX); }
	return sound ? own->count : 0;
}

/* |x - center|^2 / width^2 */
static real rbf_square(const KOOP(rbf) *own, const real *x, size_t i) {
	const real *center = own->centers + i * own->n;
	real sum = 0;
	for (size_t k = 0; k < own->n; k++) {
		const real away = (x[own->states[k]] - center[k]) / own->widths[i];
		sum += away * away;
	}
	return sum;
}

/* Writes the functions from `first` on, up to four. */
static void write_four_rbf(const KOOP(rbf) *own, const real *x, size_t first, real *out) {
	real value[4] = {0, 0, 0, 0};
	for (size_t k = 0; k < 4 && first + k < own->count; k++) { value[k] = rbf_square(own, x, first + k); }
	own->kernel->values(value);
	for (size_t k = 0; k < 4 && first + k < own->count; k++) { out[k] = value[k]; }
}

static real *write_rbf(const void *context, const real *x, real *out) {
	const KOOP(rbf) *own = (const KOOP(rbf) *)context;
	for (size_t i = 0; i < own->count; i += 4) { write_four_rbf(own, x, i, out + i); }
	return out + own->count;
}

const KOOP(part_kind) KOOP(part_rbf) = {count_rbf, write_rbf};

static void values_gaussian(real *square) {
	for (size_t k = 0; k < 4; k++) { square[k] /= 2; }
	exp_minus_four(square);
}

static void values_inverse_quadratic(real *square) {
	for (size_t k = 0; k < 4; k++) { square[k] = 1 / (1 + square[k]); }
}

static void values_inverse_multiquadric(real *square) {
	for (size_t k = 0; k < 4; k++) { square[k] = 1 / MATH(sqrt)(1 + square[k]); }
}

static void values_multiquadric(real *square) {
	for (size_t k = 0; k < 4; k++) { square[k] = MATH(sqrt)(1 + square[k]); }
}

static void values_thin_plate(real *square) {
	for (size_t k = 0; k < 4; k++) {
		square[k] = square[k] >= REAL_MIN ? square[k] * (natural_logarithm(square[k]) / 2) : 0;
	}
}

const KOOP(kernel) KOOP(gaussian) = {values_gaussian};
const KOOP(kernel) KOOP(inverse_quadratic) = {values_inverse_quadratic};
const KOOP(kernel) KOOP(inverse_multiquadric) = {values_inverse_multiquadric};
const KOOP(kernel) KOOP(multiquadric) = {values_multiquadric};
const KOOP(kernel) KOOP(thin_plate) = {values_thin_plate};

/* ---- The dictionary ---------------------------------------------------------------------------- */

static void lift_combined(const KOOP(dictionary) *self, const real *x, real *psi) {
	const KOOP(combination) *own = (const KOOP(combination) *)self->context;
	copy(psi, x, self->n_states);
	psi += self->n_states;
	for (size_t i = 0; i < own->n_parts; i++) {
		psi = own->parts[i].kind->write(own->parts[i].context, x, psi);
	}
}

/* Adds the functions of a part to *n_lifted. */
static COLD int add_part(const KOOP(part) *part, size_t n_states, size_t *n_lifted) {
	if (!part->kind || !part->kind->count || !part->kind->write) { return KOOP_E_NULL; }
	const size_t count = part->kind->count(part->context, n_states);
	if (count == 0) { return KOOP_E_RANGE; }
	if (count > KOOP_MAX_DIM - *n_lifted) { return KOOP_E_SIZE; }
	*n_lifted += count;
	return KOOP_OK;
}

COLD int KOOP(combine)(KOOP(dictionary) *dictionary, const char *name, size_t n_states,
                       const KOOP(combination) *combination) {
	static const KOOP(dictionary) combined = {"", 0, 0, lift_combined, NULL};
	if (!dictionary || !name || !combination || !combination->parts) { return KOOP_E_NULL; }
	if (n_states < 1 || n_states > KOOP_MAX_DIM) { return KOOP_E_SIZE; }
	size_t n_lifted = n_states;
	for (size_t i = 0; i < combination->n_parts; i++) {
		const int status = add_part(&combination->parts[i], n_states, &n_lifted);
		if (status != KOOP_OK) { return status; }
	}
	*dictionary = combined;
	dictionary->name = name;
	dictionary->n_states = n_states;
	dictionary->n_lifted = n_lifted;
	dictionary->context = combination;
	return KOOP_OK;
}
