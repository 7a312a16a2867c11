/* Keeps a learned model in flash so that power may fail at any moment: two slots are written in turn, and what
 * is lost is one version at most.
 *
 * A slot is the stored model and, written last, a sequence number and its complement. At start the newest slot
 * that is whole is loaded. To use it, put your flash's erase, program and read into the place of those here.
 *
 * The flash is simulated: programming can only clear bits, erasing sets them all, and the supply may fail
 * between two words. main() lets it fail at every word of a save, and of the save after that. */
#include "tinykoop.h"

#include <stdio.h>
#include <string.h>

/* ---- A simulated flash, of two slots -------------------------------------------------- */

enum { MODEL = KOOPF_MODEL_BYTES_P(7, 2), SLOT = MODEL + 8, WORD = 4 };

static unsigned char flash[2][(SLOT + WORD - 1) / WORD * WORD];
static long words_until_failure; /* of the supply; below 0 it holds */

/* Returns 0 where the supply has failed. */
static int supply(void) {
	if (words_until_failure == 0) { return 0; }
	words_until_failure--;
	return 1;
}

static void flash_erase(int slot) {
	for (size_t at = 0; at < sizeof flash[slot] && supply(); at += WORD) { memset(flash[slot] + at, 0xFF, WORD); }
}

static void flash_program(int slot, size_t at, const unsigned char *bytes, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (i % WORD == 0 && !supply()) { return; }
		flash[slot][at + i] &= bytes[i];
	}
}

/* ---- Two slots ------------------------------------------------------------------------ */

static void put_number(unsigned char *at, uint32_t value) {
	for (int i = 0; i < 4; i++) { at[i] = (unsigned char)(value >> (8 * i)); }
}

static uint32_t get_number(const unsigned char *at) {
	return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Loads a slot if it is whole; *sequence is then its number. */
static int slot_load(int slot, koopf_rls *learner, uint32_t *sequence) {
	const uint32_t number = get_number(flash[slot] + MODEL);
	if (number != ~get_number(flash[slot] + MODEL + 4)) { return KOOP_E_MODEL; }
	*sequence = number;
	return koopf_model_load(learner, flash[slot], MODEL);
}

/* Loads the newest model there is. *slot and *sequence are those of it, or -1 and 0. */
static int slots_load(koopf_rls *learner, int *slot, uint32_t *sequence) {
	uint32_t number[2] = {0, 0};
	const int whole[2] = {slot_load(0, learner, &number[0]) == KOOP_OK,
	                      slot_load(1, learner, &number[1]) == KOOP_OK};
	*slot = whole[0] || whole[1] ? whole[1] : -1;
	/* the number may have begun again at 0 */
	if (whole[0] && whole[1]) { *slot = (int32_t)(number[1] - number[0]) > 0; }
	*sequence = *slot < 0 ? 0 : number[*slot];
	return *slot < 0 ? KOOP_E_MODEL : slot_load(*slot, learner, sequence);
}

/* Saves into the slot that does not hold the newest model. */
static int slots_save(const koopf_rls *learner, int newest, uint32_t sequence) {
	static unsigned char bytes[MODEL];
	unsigned char number[8];
	const int slot = newest == 0;
	const int status = koopf_model_save_covariance(learner, bytes, sizeof bytes);
	if (status != KOOP_OK) { return status; }
	put_number(number, sequence + 1);
	put_number(number + 4, ~(sequence + 1));
	flash_erase(slot);
	flash_program(slot, 0, bytes, sizeof bytes);
	flash_program(slot, MODEL, number, sizeof number); /* from here on it counts */
	return KOOP_OK;
}

/* ---- Power that fails at every word ------------------------------------------------------- */

static float storage[KOOP_RLS_REALS_SQRT(7, 2)];
static koopf_rls learner;

static void start(void) {
	const koopf_config config = {.dictionary = &koopf_poly_ddr,
	                             .n_inputs = 2,
	                             .regulator = &koopf_reg_ef,
	                             .form = &koopf_form_sqrt,
	                             .lambda = 0.98f,
	                             .p0 = 100};
	(void)koopf_rls_init(&learner, &config, storage, sizeof storage / sizeof *storage);
}

/* Theta that tells which version it is. */
static void become(int version) {
	float theta[7 * 9] = {0};
	theta[0] = (float)version;
	(void)koopf_rls_set_theta(&learner, theta);
}

/* The version that is loaded at start, or -1. */
static int boot(int *slot, uint32_t *sequence) {
	start();
	return slots_load(&learner, slot, sequence) == KOOP_OK ? (int)learner.theta[0] : -1;
}

/* Version 1 is there, 2 is saved while the supply fails after some words, then 3 in the same way. Returns how many
 * versions were lost, or -1 where all were. */
static int try_failures(long first, long second, uint32_t sequence) {
	int slot = 0, version;
	memset(flash, 0, sizeof flash);
	start();
	become(1);
	words_until_failure = -1;
	(void)slots_save(&learner, 1, sequence);
	if (boot(&slot, &sequence) != 1) { return -1; }
	become(2);
	words_until_failure = first;
	(void)slots_save(&learner, slot, sequence);
	version = boot(&slot, &sequence);
	if (version < 1) { return -1; }
	become(3);
	words_until_failure = second;
	(void)slots_save(&learner, slot, sequence);
	const int last = boot(&slot, &sequence);
	return last == 3 ? 0 : last == version ? 3 - version : -1;
}

int main(void) {
	const long words = 2 * (long)sizeof flash[0] / WORD + 1; /* erased, and programmed */
	long trials = 0;
	for (uint32_t sequence = 0xFFFFFFFD; sequence != 1; sequence++) {
		for (long first = 0; first <= words; first += first < words - 8 ? 7 : 1) {
			for (long second = 0; second <= words; second++, trials++) {
				const int lost = try_failures(first, second, sequence), most = (first < words) + (second < words);
				if (lost < 0 || lost > most) {
					printf("power failed after %ld and %ld words: no model is left\n", first, second);
					return 1;
				}
			}
		}
	}
	printf("%ld times power failed while a model was saved: never was more lost than that version\n", trials);
	return 0;
}
