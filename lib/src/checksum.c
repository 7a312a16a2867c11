/* Checksum of an array of words that locates a single flipped bit, so that it can be repaired. It has two
 * 64-bit sums, as Fletcher's (IEEE Transactions on Communications 30(1), 1982): the sum of the words, and the
 * sum of each word times its distance from the end. A flipped bit changes the first by plus or minus its own
 * value, and the second by that times the distance. */

/* Number of words in this many reals. */
#define WORDS(reals) ((reals) * (sizeof(real) / 4))

static inline uint32_t word_at(const void *data, size_t i) {
	uint32_t word;
	(void)memcpy(&word, (const unsigned char *)data + 4 * i, sizeof word);
	return word;
}

#define CHECKSUM_ADD(i)                                                                                      \
	words += word_at(at, i);                                                                                 \
	weighted += words;

/* Continues the sums over more words. Four per iteration: the loop counter is a third of the work. */
static inline void checksum_add(koop_checksum *sum, const void *data, size_t count) {
	uint64_t words = sum->words, weighted = sum->weighted;
	const unsigned char *at = (const unsigned char *)data;
	for (; count >= 4; count -= 4, at += 16) {
		CHECKSUM_ADD(0)
		CHECKSUM_ADD(1)
		CHECKSUM_ADD(2)
		CHECKSUM_ADD(3)
	}
	for (; count > 0; count--, at += 4) { CHECKSUM_ADD(0) }
	sum->words = words;
	sum->weighted = weighted;
}

static inline int checksum_same(const koop_checksum *a, const koop_checksum *b) {
	return ((a->words ^ b->words) | (a->weighted ^ b->weighted)) == 0;
}

/* Returns 1 if the bit flipped in the sums themselves: a flipped bit of a word changes both sums. */
static COLD int checksum_has_flipped(const koop_checksum *before, const koop_checksum *now) {
	const uint64_t words = before->words ^ now->words, weighted = before->weighted ^ now->weighted;
	const uint64_t bit = words | weighted;
	return ((words == 0) | (weighted == 0)) & ((bit & (bit - 1)) == 0);
}

/* Repairs the single flipped bit that changed the sum from `before` to `now`. Returns 0 if no single bit
 * explains the change. `behind` more words were summed after these. */
static COLD int checksum_repair(void *data, size_t words, size_t behind, const koop_checksum *before,
                                const koop_checksum *now) {
	const size_t count = words + behind;
	const int is_set = now->words - before->words <= UINT32_MAX; /* 1: the bit went from 0 to 1 */
	const koop_checksum *more = is_set ? now : before, *less = is_set ? before : now;
	uint64_t bit = more->words - less->words, distance = more->weighted - less->weighted;
	const uint32_t flipped = (uint32_t)bit;
	for (; bit > 1 && ((bit | distance) & 1) == 0; bit /= 2) { distance /= 2; }
	if ((bit != 1) | (flipped == 0) | (distance <= behind) | (distance > count)) { return 0; }
	const size_t i = count - (size_t)distance;
	const uint32_t word = word_at(data, i), fits = ((word & flipped) != 0) == is_set;
	const uint32_t repaired = word ^ (fits * flipped);
	(void)memcpy((unsigned char *)data + 4 * i, &repaired, sizeof repaired);
	return (int)fits;
}
