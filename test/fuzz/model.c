/* A stored model of any bytes, also with a right checksum, and a right header. */
#include "world.h"

#include <string.h>

enum { CHECKSUM_AT = 20, AS_IT_IS = 0, SEALED = 1, WITH_HEADER = 2, WITH_COVARIANCE = 3, MODES = 4 };

static void lift_nothing(const KOOP(dictionary) *self, const real *x, real *psi) {
	(void)self;
	(void)x;
	(void)psi;
}

static uint32_t add_to_checksum(uint32_t crc, const unsigned char *bytes, size_t count) {
	for (; count > 0; count--) {
		crc ^= *bytes++;
		for (int bit = 0; bit < 8; bit++) { crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1; }
	}
	return crc;
}

static void seal(unsigned char *bytes, size_t size) {
	if (size < KOOP_MODEL_HEADER_BYTES) { return; }
	const uint32_t crc = ~add_to_checksum(add_to_checksum(~0u, bytes, CHECKSUM_AT),
	                                      bytes + KOOP_MODEL_HEADER_BYTES, size - KOOP_MODEL_HEADER_BYTES);
	for (int i = 0; i < 4; i++) { bytes[CHECKSUM_AT + i] = (unsigned char)(crc >> (8 * i)); }
}

/* Whether the numbers behind the header are finite. */
static int is_finite(const unsigned char *bytes, size_t size) {
	for (size_t at = KOOP_MODEL_HEADER_BYTES; at < size; at += sizeof(real)) {
		real value;
		memcpy(&value, bytes + at, sizeof value);
		if (!isfinite(value)) { return 0; }
	}
	return 1;
}

/* With P where the size is that of `both`. */
static int save(const KOOP(rls) *rls, unsigned char *bytes, size_t size, size_t both) {
	return size == both ? KOOP(model_save_covariance)(rls, bytes, size) : KOOP(model_save)(rls, bytes, size);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
	input in = {data, size};
	KOOP(dictionary) dictionary = {"bytes", 1, 1 + take_below(&in, 5), lift_nothing, NULL};
	const KOOP(config) config = {.dictionary = &dictionary,
	                             .n_inputs = 1 + take_below(&in, 3),
	                             .regulator = &KOOP(reg_ef),
	                             .form = &KOOP(form_plain),
	                             .lambda = 1,
	                             .p0 = 1};
	KOOP(rls) rls = {0};
	size_t reals = 0;
	EXPECT(KOOP(rls_reals)(&config, &reals) == KOOP_OK, "settings");
	EXPECT(KOOP(rls_init)(&rls, &config, allocate(reals * sizeof(real)), reals) == KOOP_OK, "settings");

	const size_t mode = take_below(&in, MODES), theta = MODEL_BYTES(rls.n_lifted, config.n_inputs);
	const size_t both = MODEL_BYTES_P(rls.n_lifted, config.n_inputs);
	const size_t length = mode == WITH_COVARIANCE ? both : mode == WITH_HEADER ? theta : in.left;
	unsigned char *model = allocate(length), *again = allocate(length), *header = allocate(length);
	take(&in, model, length);
	if (mode >= WITH_HEADER) {
		EXPECT(save(&rls, header, length, both) == KOOP_OK, "cannot be saved");
		memcpy(model, header, KOOP_MODEL_HEADER_BYTES);
	}
	if (mode != AS_IT_IS) { seal(model, length); }

	const learned before = learned_take(&rls);
	const int status = KOOP(model_load)(&rls, model, length);
	if (mode == WITH_HEADER) { EXPECT((status == KOOP_OK) == is_finite(model, length), "status %d", status); }
	if (status == KOOP_OK) {
		EXPECT(length == theta || length == both, "%zu bytes are no model", length);
		EXPECT(save(&rls, again, length, both) == KOOP_OK, "cannot be saved");
		/* one of format 1 is saved in the format of today */
		EXPECT(model[4] == 1 || memcmp(model, again, length) == 0, "another model is saved than was loaded");
	} else {
		EXPECT(status == KOOP_E_MODEL, "status %d", status);
		learned_expect(&before, &rls, "refused model_load()");
	}
	learned_check(&rls);
	free_all();
	return 0;
}
