/* A stored model's bytes, written and read apart from the library. */
#ifndef STORED_H
#define STORED_H

#include "precision.h"

#include <string.h>

enum { STORED_HEADER = 24, STORED_CHECKSUM_AT = 20 };

/* CRC-32 by remainders of a byte; begins with all ones, and is complemented at the end */
static inline uint32_t stored_crc(uint32_t crc, const void *data, size_t count) {
	const unsigned char *bytes = data;
	for (size_t i = 0; i < count; i++) {
		uint32_t remainder = (crc ^ bytes[i]) & 0xFFu;
		for (int bit = 0; bit < 8; bit++) {
			remainder = remainder & 1 ? (remainder >> 1) ^ 0xEDB88320u : remainder >> 1;
		}
		crc = (crc >> 8) ^ remainder;
	}
	return crc;
}

static inline void stored_number(unsigned char *at, uint32_t value, int bytes) {
	for (int i = 0; i < bytes; i++) { at[i] = (unsigned char)(value >> (8 * i)); }
}

/* Makes a model that was tampered with valid again. */
static inline void stored_seal(unsigned char *model, size_t size) {
	uint32_t crc = stored_crc(0xFFFFFFFFu, model, STORED_CHECKSUM_AT);
	crc = stored_crc(crc, model + STORED_HEADER, size - STORED_HEADER);
	stored_number(model + STORED_CHECKSUM_AT, ~crc, 4);
}

static inline void stored_copy(unsigned char *to, const unsigned char *from, int turned) {
	for (size_t i = 0; i < sizeof(real); i++) { to[i] = from[turned ? sizeof(real) - 1 - i : i]; }
}

static inline int stored_host_is_big_endian(void) {
	static const uint16_t one = 1;
	return *(const unsigned char *)&one == 0;
}

/* A number as it is stored in either byte order, on a machine of any. */
static inline void stored_put(unsigned char *at, real value, int big_endian) {
	unsigned char bytes[sizeof value];
	memcpy(bytes, &value, sizeof value);
	stored_copy(at, bytes, stored_host_is_big_endian() != big_endian);
}

static inline real stored_get(const unsigned char *at, int big_endian) {
	unsigned char bytes[sizeof(real)];
	real value;
	stored_copy(bytes, at, stored_host_is_big_endian() != big_endian);
	memcpy(&value, bytes, sizeof value);
	return value;
}

#endif
