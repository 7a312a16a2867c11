/* A stored model: header, then Theta by rows as `real`, all little-endian.
 *
 *     0  "KOOP"      4  format 1    6  bytes of a real   8  N   10  m   12  n   14  0
 *    16  hash of the dictionary's name      20  CRC-32 of all but itself */

#include <string.h>

static COLD void put(unsigned char *at, uint32_t value, size_t bytes) {
	for (size_t i = 0; i < bytes; i++) { at[i] = (unsigned char)(value >> (8 * i)); }
}

/* CRC-32 of IEEE 802.3, bit by bit: it is run once, at start-up */
static COLD uint32_t crc32(uint32_t crc, const unsigned char *bytes, size_t count) {
	crc = ~crc;
	for (size_t i = 0; i < count; i++) {
		crc ^= bytes[i];
		for (int bit = 0; bit < 8; bit++) { crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u))); }
	}
	return ~crc;
}

static COLD void model_header(const KOOP(rls) *rls, unsigned char *header) {
	const char *name = rls->config.dictionary->name;
	(void)memcpy(header, "KOOP", 4);
	put(header + 4, 1, 2);
	put(header + 6, sizeof(real), 2);
	put(header + 8, (uint32_t)rls->n_lifted, 2);
	put(header + 10, (uint32_t)rls->config.n_inputs, 2);
	put(header + 12, (uint32_t)rls->config.dictionary->n_states, 2);
	put(header + 14, 0, 2);
	put(header + 16, crc32(0, (const unsigned char *)name, strlen(name)), 4);
}

static COLD size_t model_bytes(const KOOP(rls) *rls) {
	return KOOP_MODEL_HEADER_BYTES + sizeof(real) * rls->n_lifted * rls->n_regressors;
}

static COLD uint32_t model_checksum(const unsigned char *model, size_t size) {
	return crc32(crc32(0, model, 20), model + KOOP_MODEL_HEADER_BYTES, size - KOOP_MODEL_HEADER_BYTES);
}

COLD int KOOP(model_save)(const KOOP(rls) *rls, void *bytes, size_t size) {
	if (!rls || !rls->theta || !bytes) { return KOOP_E_NULL; }
	if (size < model_bytes(rls)) { return KOOP_E_STORAGE; }
	unsigned char *model = (unsigned char *)bytes, *at = model + KOOP_MODEL_HEADER_BYTES;
	model_header(rls, model);
	for (size_t i = 0; i < rls->n_lifted; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++, at += sizeof(real)) {
			memcpy(at, &rls->theta[j * rls->n_lifted_padded + i], sizeof(real));
		}
	}
	put(model + 20, model_checksum(model, model_bytes(rls)), 4);
	return KOOP_OK;
}

COLD int KOOP(model_load)(KOOP(rls) *rls, const void *bytes, size_t size) {
	if (!rls || !rls->theta || !bytes) { return KOOP_E_NULL; }
	const unsigned char *model = (const unsigned char *)bytes, *at = model + KOOP_MODEL_HEADER_BYTES;
	unsigned char expected[KOOP_MODEL_HEADER_BYTES];
	if (size != model_bytes(rls)) { return KOOP_E_MODEL; }
	model_header(rls, expected);
	put(expected + 20, model_checksum(model, size), 4);
	if (memcmp(model, expected, sizeof expected) != 0) { return KOOP_E_MODEL; }

	real largest = 0;
	for (size_t i = 0; i < rls->n_lifted * rls->n_regressors; i++) {
		real value;
		memcpy(&value, at + i * sizeof(real), sizeof(real));
		if (!is_finite(value)) { return KOOP_E_MODEL; }
		largest = max_of(largest, MATH(fabs)(value));
	}
	for (size_t i = 0; i < rls->n_lifted; i++) {
		for (size_t j = 0; j < rls->n_regressors; j++, at += sizeof(real)) {
			memcpy(&rls->theta[j * rls->n_lifted_padded + i], at, sizeof(real));
		}
	}
	rls->theta_bound = largest;
	return KOOP_OK;
}
