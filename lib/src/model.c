/* A stored model: a header, Theta by rows, and optionally P. All numbers are little-endian on every machine.
 *
 *     0  "KOOP"      4  format 2    6  bytes of a real   8  N   10  m   12  n   14  triangles of P, 0 to 2
 *    16  hash of the dictionary's name, and with P of the form's      20  CRC-32 of all other bytes
 *
 * P is stored as its form represents it: a lower triangle by rows, of P or of its square root. The plain form
 * adds a triangle of P^-1 if the regulator needs it. Behind P comes the regulator's memory, if it has one;
 * the hash is then of the regulator's name too.
 *
 * Format 1 has Theta in the byte order of the machine that wrote it, and does not record that order. It is
 * read if only one order gives numbers of plausible magnitude. */

#include <string.h>

#define MODEL_FORMAT 2
#define MODEL_FORMAT_ANY_ORDER 1

static COLD void put(unsigned char *at, REAL_BITS value, size_t bytes) {
	for (size_t i = 0; i < bytes; i++) { at[i] = (unsigned char)(value >> (8 * i)); }
}

static COLD unsigned char *put_real(unsigned char *at, real value) {
	put(at, bits_of(value), sizeof value);
	return at + sizeof value;
}

/* Reads a real in little-endian or big-endian order. */
static COLD real get_real(const unsigned char *at, int big_endian) {
	REAL_BITS bits = 0;
	real value;
	for (size_t i = 0; i < sizeof bits; i++) {
		bits |= (REAL_BITS)at[i] << (8 * (big_endian ? sizeof bits - 1 - i : i));
	}
	(void)memcpy(&value, &bits, sizeof value);
	return value;
}

/* CRC-32 of IEEE 802.3, bit by bit: speed does not matter at start-up. */
static COLD uint32_t crc32(uint32_t crc, const unsigned char *bytes, size_t count) {
	crc = ~crc;
	for (size_t i = 0; i < count; i++) {
		crc ^= bytes[i];
		for (int bit = 0; bit < 8; bit++) { crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u))); }
	}
	return ~crc;
}

static COLD uint32_t hash_name(uint32_t hash, const char *name) {
	return crc32(hash, (const unsigned char *)name, strlen(name));
}

/* Hash of the names on which the layout depends. */
static COLD uint32_t hash_names(const KOOP(rls) *rls, size_t triangles) {
	uint32_t hash = hash_name(0, rls->config.dictionary->name);
	if (triangles > 0) { hash = hash_name(hash, rls->config.form->name); }
	if (triangles > 0 && rls->n_memory > 0) { hash = hash_name(hash, rls->config.regulator->name); }
	return hash;
}

static COLD void model_header(const KOOP(rls) *rls, unsigned format, size_t triangles,
                              unsigned char *header) {
	(void)memcpy(header, "KOOP", 4);
	put(header + 4, (REAL_BITS)format, 2);
	put(header + 6, sizeof(real), 2);
	put(header + 8, (REAL_BITS)rls->n_lifted, 2);
	put(header + 10, (REAL_BITS)rls->config.n_inputs, 2);
	put(header + 12, (REAL_BITS)rls->config.dictionary->n_states, 2);
	put(header + 14, (REAL_BITS)triangles, 2);
	put(header + 16, hash_names(rls, triangles), 4);
}

static COLD size_t model_bytes(const KOOP(rls) *rls, size_t triangles) {
	const size_t d = rls->n_regressors, memory = triangles > 0 ? rls->n_memory : 0;
	return KOOP_MODEL_HEADER_BYTES +
	       sizeof(real) * (rls->n_lifted * d + triangles * (d * (d + 1) / 2) + memory);
}

static COLD uint32_t model_checksum(const unsigned char *model, size_t size) {
	return crc32(crc32(0, model, 20), model + KOOP_MODEL_HEADER_BYTES, size - KOOP_MODEL_HEADER_BYTES);
}

/* Number of triangles that represent P in the form; 0 if the form cannot store P. */
static COLD size_t triangles_of(const KOOP(rls) *rls) {
	return rls->config.form->triangles ? rls->config.form->triangles(rls) : 0;
}

/* ---- Save ---------------------------------------------------------------------------- */

static COLD int save(const KOOP(rls) *rls, size_t triangles, void *bytes, size_t size) {
	if (size < model_bytes(rls, triangles)) { return KOOP_E_STORAGE; }
	unsigned char *model = (unsigned char *)bytes, *at = model + KOOP_MODEL_HEADER_BYTES;
	model_header(rls, MODEL_FORMAT, triangles, model);
	for (size_t i = 0; i < rls->n_lifted; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++) {
			at = put_real(at, rls->theta[j * rls->n_lifted_padded + i]);
		}
	}
	for (size_t t = 0; t < triangles; t++) {
		for (size_t i = 0; i < rls->n_regressors; i++) {
			for (size_t j = 0; j <= i; j++) { at = put_real(at, rls->config.form->get(rls, t, i, j)); }
		}
	}
	for (size_t i = 0; triangles > 0 && i < rls->n_memory; i++) { at = put_real(at, rls->memory[i]); }
	put(model + 20, model_checksum(model, model_bytes(rls, triangles)), 4);
	return KOOP_OK;
}

COLD int KOOP(model_save)(const KOOP(rls) *rls, void *bytes, size_t size) {
	if (!rls || !rls->theta || !bytes) { return KOOP_E_NULL; }
	return save(rls, 0, bytes, size);
}

COLD int KOOP(model_save_covariance)(const KOOP(rls) *rls, void *bytes, size_t size) {
	if (!rls || !rls->theta || !bytes) { return KOOP_E_NULL; }
	const size_t triangles = triangles_of(rls);
	return triangles > 0 ? save(rls, triangles, bytes, size) : KOOP_E_MODEL;
}

/* ---- Load ---------------------------------------------------------------------------- */

/* Returns 1 if the bytes are an undamaged model for this estimator. */
static COLD int model_is(const KOOP(rls) *rls, unsigned format, size_t triangles, const unsigned char *model,
                         size_t size) {
	unsigned char expected[KOOP_MODEL_HEADER_BYTES];
	if (size != model_bytes(rls, triangles)) { return 0; }
	model_header(rls, format, triangles, expected);
	put(expected + 20, model_checksum(model, size), 4);
	return memcmp(model, expected, sizeof expected) == 0;
}

/* Counts the numbers whose magnitude is plausible in this byte order: 2^-32 to 2^32. */
static COLD size_t count_plausible(const unsigned char *at, size_t reals, int big_endian) {
	const real limit = (real)4294967296;
	size_t count = 0;
	for (size_t i = 0; i < reals; i++, at += sizeof(real)) {
		const real size = MATH(fabs)(get_real(at, big_endian));
		count += size * limit >= 1 && size <= limit ? 1 : 0;
	}
	return count;
}

/* Guesses the byte order: 0 little-endian, 1 big-endian, -1 undecided. */
static COLD int guess_order(const unsigned char *at, size_t reals) {
	const size_t plausible[2] = {count_plausible(at, reals, 0), count_plausible(at, reals, 1)};
	size_t zeros = 0;
	for (size_t i = 0; i < reals; i++) { zeros += is_zero(get_real(at + i * sizeof(real), 0)) ? 1 : 0; }
	for (int big_endian = 0; big_endian < 2; big_endian++) {
		const int fits = 4 * plausible[big_endian] >= 3 * (reals - zeros),
		          other = 2 * plausible[!big_endian] >= reals - zeros;
		if (fits && !other) { return big_endian; }
	}
	return -1;
}

static COLD int all_finite_in(const unsigned char *at, size_t reals, int big_endian) {
	int finite = 1;
	for (size_t i = 0; i < reals; i++) { finite &= is_finite(get_real(at + i * sizeof(real), big_endian)); }
	return finite;
}

static COLD const unsigned char *load_theta(KOOP(rls) *rls, const unsigned char *at, int big_endian) {
	real largest = 0;
	for (size_t i = 0; i < rls->n_lifted; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++, at += sizeof(real)) {
			const real value = get_real(at, big_endian);
			rls->theta[j * rls->n_lifted_padded + i] = value;
			largest = max_of(largest, MATH(fabs)(value));
		}
	}
	rls->theta_bound = largest;
	return at;
}

/* Returns 1 if every diagonal element is large enough for P or its square root. */
static COLD int diagonals_are_positive(const unsigned char *at, size_t triangles, size_t d) {
	int positive = 1;
	for (size_t t = 0; t < triangles; t++, at += d * (d + 1) / 2 * sizeof(real)) {
		for (size_t i = 0; i < d; i++) {
			positive &= get_real(at + (i * (i + 1) / 2 + i) * sizeof(real), 0) >= REAL_MIN;
		}
	}
	return positive;
}

static COLD void load_covariance(KOOP(rls) *rls, size_t triangles, const unsigned char *at) {
	real largest = 0;
	rls->config.form->reset(rls, 1);
	for (size_t t = 0; t < triangles; t++) {
		for (size_t i = 0; i < rls->n_regressors; i++) {
			for (size_t j = 0; j <= i; j++, at += sizeof(real)) {
				const real value = get_real(at, 0);
				rls->config.form->set(rls, t, i, j, value);
				largest = max_of(largest, MATH(fabs)(value));
			}
		}
	}
	for (size_t i = 0; i < rls->n_memory; i++, at += sizeof(real)) { rls->memory[i] = get_real(at, 0); }
	rls->covariance_bound = largest * MATH(sqrt)((real)rls->n_regressors);
	rls->positive_definite = 1;
}

/* Finds the byte order and the number of triangles, or returns KOOP_E_MODEL. */
static COLD int model_check(const KOOP(rls) *rls, const unsigned char *model, size_t size, size_t *triangles,
                            int *big_endian) {
	const size_t own = triangles_of(rls), reals = rls->n_lifted * rls->n_regressors;
	const unsigned char *at = model + KOOP_MODEL_HEADER_BYTES;
	*big_endian = 0;
	*triangles = size == model_bytes(rls, own) ? own : 0;
	if (model_is(rls, MODEL_FORMAT_ANY_ORDER, 0, model, size)) {
		*big_endian = guess_order(at, reals);
		return *big_endian < 0 || !all_finite_in(at, reals, *big_endian) ? KOOP_E_MODEL : KOOP_OK;
	}
	if (!model_is(rls, MODEL_FORMAT, *triangles, model, size)) { return KOOP_E_MODEL; }
	if (!all_finite_in(at, (size - KOOP_MODEL_HEADER_BYTES) / sizeof(real), 0)) { return KOOP_E_MODEL; }
	at += reals * sizeof(real);
	return diagonals_are_positive(at, *triangles, rls->n_regressors) ? KOOP_OK : KOOP_E_MODEL;
}

COLD int KOOP(model_load)(KOOP(rls) *rls, const void *bytes, size_t size) {
	if (!rls || !rls->theta || !bytes) { return KOOP_E_NULL; }
	const unsigned char *at = (const unsigned char *)bytes + KOOP_MODEL_HEADER_BYTES;
	size_t triangles;
	int big_endian;
	const int status = model_check(rls, (const unsigned char *)bytes, size, &triangles, &big_endian);
	if (status != KOOP_OK) { return status; }
	at = load_theta(rls, at, big_endian);
	if (triangles > 0) { load_covariance(rls, triangles, at); }
	seal(rls);
	return KOOP_OK;
}
